"""One damper's signals as every log format has them: position and force at one rate, the current at another."""

from __future__ import annotations

import numpy as np
from proposal_bags import motion

from ces_data.logs.log_import import to_recording
from ces_data.mapping.proposals import propose_mapping

T, X, CURRENT, F = motion(samples=1200)
T_SLOW, I_SLOW = T[::4] + 0.0005, CURRENT[::4]
START_NS = 1_714_564_800_250_000_000  # 2024-05-01 12:00:00.25 UTC


def assert_recording(recording, start_ns=0, slow=True, rtol=1e-9):
    """Compare position, current and force with the signals, each at its own times."""
    t_current, i = (T_SLOW, I_SLOW) if slow else (T, CURRENT)
    for name, t, values in (("position", T, X), ("current", t_current, i), ("force", T, F)):
        channel = recording.channel(name)
        np.testing.assert_allclose(channel.values, values, rtol=rtol, atol=rtol * np.abs(values).max())
        np.testing.assert_allclose(channel.stamps_ns - start_ns, np.rint(t * 1e9), atol=1000)


def assert_proposed(path, start_ns=0, slow=True, rtol=1e-9, **options):
    """Compare what is read without a mapping with the signals, and return the proposal; it must have no doubts."""
    proposal = propose_mapping(path, **options)
    assert proposal.doubts == ()
    assert_recording(to_recording(proposal.log, proposal.mapping), start_ns, slow, rtol)
    return proposal
