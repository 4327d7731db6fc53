"""Models of all structures with and without a delay, as different as models can be, to be exported as C."""

import random
from dataclasses import replace

from bands import BAND
from constructed_models import TERMS as CONSTRUCTED
from exported_c import with_delay
from hydraulic_models import ENVELOPE, GROOVE, SAMPLING, hydraulic_model, make_hydraulic
from mixture_models import mixture_model
from physical_examples import make_valve
from recurrent_models import make_recurrent, recurrent_model
from samplings import make_sampling
from trained_models import FUZZY, NETWORK, fuzzy_model, network_model

from ces_observer.model import Model
from ces_observer.structures.curves import FlowMap
from ces_observer.structures.fuzzy import Bell, Premise, Rule
from ces_observer.structures.hydraulic import EDGES
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.polynomial import Factor, Polynomial, Term


def f(signal, lag=0, power=1.0, signed=True):
    return Factor(signal, lag, power, signed)


def make(*terms, **sampling):
    settings = {"outlier_m": 0.004, "warm_up_s": 0.1, **sampling}
    return Model(make_sampling(**settings), Polynomial(tuple(terms)), ENVELOPE, (-9e3, 8e3))


PLAIN = (
    Term(1200.0, (f("speed", 0, 0.5),)),
    Term(700.0, (f("speed", 2), f("current", 5, 1.0, False))),
    Term(100.1, (f("speed", 0, 0.5, False), f("current", 10, 2.0, False))),
    Term(30.0, (f("speed", 0, 1.5),)),
    Term(-5.0, ()),
    Term(0.3, (f("force", 1),)),
    Term(0.1, (f("force", 1), f("speed", 0, 0.5, False))),
    Term(-0.02, (f("force", 1), f("speed", 2), f("current", 5, 1.0, False))),
)
LAGS = (
    Term(1 / 3, (f("force", 1),)),
    Term(-0.1, (f("force", 2), f("current", 0))),
    Term(0.07, (f("force", 7), f("speed", 64, 1.0, False))),
    Term(0.05, (f("force", 33), f("current", 1), f("position", 3, 0.5, False))),
    Term(900.0, (f("speed", 1),)),
    Term(2000.0, (f("position", 100), f("current", 17, 2.0, False))),
)
MANY_FACTORS = (
    Term(800.0, (f("speed"), f("current", 1), f("current", 2))),
    Term(1e5, (f("position", 1), f("speed", 1, 1.0, False), f("current", 4), f("speed", 0, 0.5, False))),
    Term(400.0, (f("speed"), *(f("current", lag, 0.5) for lag in range(7)))),
    Term(0.4, (f("force", 3), f("current"), f("current", 1), f("current", 2), f("speed", 0, 0.0, False))),
)
POWERS = (
    Term(50.0, (f("speed", 0, 0.0),)),
    Term(7.0, (f("speed", 0, 0.0, False), f("current"))),
    *(Term(40.0 + p, (f("speed", 1, p),)) for p in (0.3, 1e-05, 0.75, 2.0, 2.5, 3.0, 4.0, 4.5, 5.0, 8.0)),
    *(Term(30.0 - p, (f("speed", 0, p, False),)) for p in (0.3, 1.0, 1.5, 3.5, 6.123456789012345)),
    Term(3e4, (f("position", 0, 1.25),)),
    Term(0.5, (f("force", 1), f("current", 0, 0.1, False))),
)
PUBLISHED = (  # two factors of the speed in a term, as in the thesis' noise model
    Term(900.0, (f("current", 0, 1.0, False), f("speed", 0, 0.6, False), f("speed", 1, 0.0))),
    Term(0.2, (f("force", 2), f("current", 1, 1.0, False), f("speed", 0, 1.0))),
    Term(-0.3, (f("force", 2), f("current", 0, 1.0, False), f("speed", 1, 0.2, False), f("speed", 3, 0.0))),
    Term(0.2, (f("force", 2), f("speed", 2, 1.0, False), f("speed", 0, 0.0))),
    Term(40.0, (f("speed", 1, 0.6, False),)),
)
OVERFLOWING = (Term(0.3, (f("force", 1),)), Term(1.5e308, (f("speed", 0, 1.0, False),)))
UNSTABLE = (Term(1.02, (f("force", 1),)), Term(60.0, (f("speed"),)), Term(2.0, ()))


def drawn(seed):
    dice = random.Random(seed)
    powers = (0.0, 0.5, 1.0, 1.5, 2.0, 0.7, 3.0)

    def factor():
        return f(
            dice.choice(["speed", "current", "position"]), dice.randint(0, 20), dice.choice(powers), dice.random() < 0.5
        )

    def term(past):
        inputs = tuple(factor() for _ in range(dice.randint(0, 4)))
        return (
            Term(dice.uniform(-0.12, 0.12), (f("force", dice.randint(1, 12)), *inputs))
            if past
            else Term(dice.uniform(-300, 900), inputs)
        )

    return [term(k % 3 == 0) for k in range(20)]


ONE_INPUT = (Regressor("speed", 64, -0.1, 0.3),)
SLOW = make_sampling(400.0, 0.004, warm_up_s=0.1)
LONG_GAP = replace(SAMPLING, rate_Hz=1333.3, max_gap_s=0.2, warm_up_s=0.0)
SPEED = {"motion": "speed", "motion_noise": 5e-3}
ACCELERATION = {"motion": "acceleration", "motion_noise": 0.5}
LARGEST = FlowMap(
    tuple((k - 20) / 40 for k in range(64)),
    tuple(tuple((k - 20) * (20.0 + row) + (k > 25) * 9.0 * row for k in range(64)) for row in range(16)),
)
SMALLEST = FlowMap((0.0, 1.0), ((0.0, 500.0),))
PLAIN_VALVE = make_valve(hysteresis_A=0.0)
MODELS = {
    "plain": lambda: make(*PLAIN),
    "plain, with a band": lambda: replace(make(*PLAIN, noise_m=1e-4), band=BAND),
    "many factors": lambda: make(*MANY_FACTORS, outlier_m=0.02),
    "powers": lambda: make(*POWERS, frequencies_Hz=(20.0,)),
    "published regressors": lambda: make(*PUBLISHED, warm_up_s=0.0),
    "slower ticks than samples": lambda: make(*PLAIN, rate_Hz=400.0),
    "several output lags, odd rate and a long gap": lambda: make(*LAGS, rate_Hz=1333.3, max_gap_s=0.2, warm_up_s=0.0),
    "a short stroke": lambda: make(*PLAIN, stroke_m=(-0.014, 0.0155)),
    "unstable": lambda: make(*UNSTABLE, warm_up_s=0.05),
    "overflowing": lambda: make(*OVERFLOWING, warm_up_s=0.05),
    "a constant": lambda: make(Term(7.0, ())),
    "its own past only": lambda: make(Term(0.9, (f("force", 1),)), Term(10.0, ())),
    "no past": lambda: make(Term(900.0, (f("speed"),)), Term(1e4, (f("position", 0, 1.0, False),))),
    "ticks every 2^20 ns": lambda: make(*PLAIN, rate_Hz=1e9 / 2**20),
    "constructed inputs": lambda: make(*CONSTRUCTED),
    "constructed inputs without a lag": lambda: make(*CONSTRUCTED[:3]),
    "drawn": lambda: make(*drawn(1)),
    "measured speed": lambda: make(*LAGS, **SPEED),
    "measured acceleration": lambda: make(*PLAIN, **ACCELERATION),
    "a delay": lambda: with_delay(replace(make(*PLAIN), band=BAND), 0.005),
    "a delay, slow ticks": lambda: with_delay(make(*LAGS, rate_Hz=400.0), 0.0025),
    "a delay, overflowing": lambda: with_delay(make(*OVERFLOWING, warm_up_s=0.0), 0.001),
    "a delay, measured speed": lambda: with_delay(make(*PLAIN, **SPEED), 0.004),
    "a delay, constructed inputs": lambda: with_delay(replace(make(*CONSTRUCTED), band=BAND), 0.02),
    "a delay, measured acceleration": lambda: with_delay(make(*POWERS, **ACCELERATION), 0.002),
    "a delay, network": lambda: with_delay(network_model(), 0.001),
    "a delay, hydraulic": lambda: with_delay(hydraulic_model(make_hydraulic(PLAIN_VALVE, mount_m_N=0.0)), 0.006),
    "network": network_model,
    "network of one input without units": lambda: network_model(
        replace(NETWORK, regressors=ONE_INPUT, linear=(0.7,), units=())
    ),
    "rules": fuzzy_model,
    "one rule": lambda: fuzzy_model(
        replace(
            FUZZY,
            regressors=ONE_INPUT,
            premises=(Premise("position", 7, (Bell(-0.01, 2.0, 0.5),)),),
            rules=(Rule((0,), 0.2, (0.5,)),),
        )
    ),
    "unstable rules": lambda: fuzzy_model(replace(FUZZY, rules=(Rule((0, 0), 0.1, (1.3, 0.0, 0.2, 0.0, 0.0)),))),
    "hydraulic": lambda: hydraulic_model(make_hydraulic(make_valve(5.7), bypass=GROOVE), LONG_GAP),
    "hydraulic, largest maps, no friction": lambda: hydraulic_model(
        make_hydraulic(
            PLAIN_VALVE, **dict.fromkeys(EDGES, LARGEST), side=replace(make_hydraulic(PLAIN_VALVE).side, friction=())
        ),
        SLOW,
    ),
    "hydraulic, smallest maps": lambda: hydraulic_model(
        make_hydraulic(PLAIN_VALVE, **dict.fromkeys(EDGES, SMALLEST), compression_growth_1_m=0.0, base_s=0.0)
    ),
    "recurrent": recurrent_model,
    "mixture": mixture_model,
    "recurrent, one network without a current": lambda: recurrent_model(make_recurrent(3, 1, current=False)),
    "a delay, recurrent": lambda: replace(with_delay(recurrent_model(), 0.004), band=BAND),
}
