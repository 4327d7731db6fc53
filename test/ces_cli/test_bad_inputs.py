"""Every mistake of a user: one line that says what is wrong and what to do, exit status 2, and nothing written."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from mistaken_files import fill_with_mistakes
from programs import error_line
from shared_results import SharedResults

# Words of `ces`, in the folder that mistaken_files fills, and a part of the line that they must give.
TABLE = """\
identify | no recording given
identify nowhere --out m.json | nowhere: no such file
identify b.csv --out m.json | b.csv: position: 'x' holds too few numbers (2 in 2 rows
identify one --terms 0 | --terms
identify one --structre hydraulic | unrecognized arguments: --structre hydraulic; did you mean '--structure'?
identify one --split 2 | --split
identify one | model.json: exists; choose another name for --out, or replace it
identify one --candidates none.yaml --out m.json | none.yaml
identify one --candidates explode.yaml --out m.json | 4096000000 terms; at most
identify one --out nowhere/m.json | the folder nowhere does not exist
identify one --out full | full: is a folder; expected the name of a file
identify one --out m.json --report taken | taken: exists; choose another name
identify one --out m.json --report m.json | m.json: is named by --out and --report
identify one --teacher model.json --overwrite | model.json: is an input, too
identify one --validate two --out mine.json --report empty | empty/mine_on_two.html: exists; choose another name
identify one two --folds 3 --out m.json | --folds 3: 2 recordings
identify one two --folds 1 --out m.json | expected at least 2
identify one --folds 9 --out m.json | use fewer folds
identify one --validate one --out m.json | one: the same recording, for identification and for validation
identify one --validate copy --out m.json | one and copy: the same recording, for identification and for validation
identify one copy --out m.json | one and copy: the same recording, twice for identification
identify one one --out m.json | one: the same recording, twice for identification
identify still --out m.json | position: constant
identify spotted --out m.json | samples are NaN
identify infinite --out m.json | force
identify unfed --out m.json | current
identify half --out m.json | current
identify back --out m.json | backward
identify rates --out m.json | Hz
identify other --out m.json | /other (std_msgs/msg/Float64)
identify s06 --candidates rules.yaml --out m.json | 0 ticks with a measured force past warm-up; expected at least 50
identify s12 --candidates rules.yaml --out m.json | too short for estimation and selection; expected more than 4 s
identify coarse --candidates rules.yaml --terms 100 --out m.json | estimation ticks; expected at least 200: record
identify one mm --out m.json | mm: position: spans 27
identify one mA --out m.json | mA: current: reaches 6
identify one kN --out m.json | by 1000 if it is in kN
identify one turned --out m.json | turned: force: acts with the motion
identify one --validate mirrored --out m.json | --ignore-findings identifies all the same
identify --campaign campaign.yaml --out o --terms 9 | --terms has no effect with --campaign; set it in
identify --campaign campaign.yaml | add --out DIR
identify --campaign campaign.yaml --out campaign.yaml | campaign.yaml: is not a folder
identify --campaign absent.yaml --out o | nowhere: no such file
identify --campaign reversed.yaml --out o | turned: force: acts with the motion
identify --campaign twice.yaml --out o | one and copy: the same recording, twice for identification
identify one --jobs 2 | --jobs applies to campaigns; add --campaign FILE.yaml
identify one --campaign c.yaml | BAG has no effect with --campaign; set it in c.yaml instead
identify --campaign c.yaml --seed 1 | --seed has no effect with --campaign
identify --show-candidates one | BAG does not apply with --show-candidates
identify one --structure sigmoid --terms 25 | --terms applies to --structure polynomial or auto, not to sigmoid
identify one --structure sigmoid --method thesis | --method applies to --structure polynomial or auto, not to sigmoid
identify one --structure sigmoid --candidates rules.yaml | --candidates applies to --structure polynomial or auto
identify one --structure anfis --blend speed:0,1 | --blend applies to --structure polynomial or auto
identify one --units 9 | --units applies to --structure sigmoid or auto, not to polynomial
identify one --lags 2,2,2 | --lags applies to --structure sigmoid or auto
identify one --rules 5x2 | --rules applies to --structure anfis or auto
identify one --kind monotube | --kind applies to --structure hydraulic or auto
identify one --curves 3 | --curves applies to --structure hydraulic or auto
identify one --structure sigmoid --lags 2,4 | '2,4' is not Y,C,V
identify one --structure sigmoid --lags 2,-1,3 | not Y,C,V
identify one --structure sigmoid --lags 21,1,1 | from 0 to 20
identify one --structure sigmoid --lags 2,0,0 | leaves no input
identify one --structure anfis --rules axb | not VxI
identify one --structure anfis --rules 1x2 | at least 2
identify one --structure anfis --rules 20x4 | makes 80 rules
validate model.json | no recording given
validate model.json b.csv | b.csv: position: 'x' holds too few numbers (2 in 2 rows
validate model.json two --part 1 0 | no part from 1.0 s to 0.0 s; expected 0 <= from < to
validate model.json two --part 90 99 | no part from 90 s to 99 s; it has
characterise two --part 1 1.00001 | expected at least 2
diagnose --sim model.json --real two --part 1 two --out new | found 'two'; expected a number from 0 s
identify one --campaign c.yaml --out new --part 0 1 | --part does not apply to campaigns
validate model.json two --weight everything=2 | --weight everything=2: expected zero_crossing
validate model.json two --report taken | taken: exists; choose another name
validate model.json two --report new.pdf | a report is an HTML page; expected a name that ends in .html
validate model.json two --report empty | empty/model_on_two.html: exists; choose another name
validate model.json --certificate --report r.html | --report applies to recordings; name them
validate two model.json | two: is a folder, such as a bag, and no model
validate no_envelope.json two | key 'force_envelope_N' is missing
validate old.json two | schema is 'ces-model/0'
validate nan.json two | coefficient is nan
validate lag.json two | lag is 1000000
validate cut.json two | cut.json: not a JSON file
simulate --sim model.json b.csv --out x.csv | b.csv: position: 'x' holds too few numbers (2 in 2 rows
simulate --sim what one --out x.csv | 'what' is no simulation; expected MODEL.json, AUGMENTED.json
simulate --sim topic:/none one --out x.csv | no topic /none; it has /joint_states
simulate --sim no_module:f one --out x.csv | cannot be imported
simulate --sim my/sim.py one --out x.csv | 'my/sim.py' is a file; expected sim:FUNCTION
simulate --sim model.json one --out taken | taken: exists; choose another name
simulate --sim model.json one --out model.json --overwrite | model.json: is an input, too
simulate --sim none.fmu one --out x.csv | none.fmu: no such file
simulate --sim broken.fmu one --out x.csv | not a zip file
replay model.json b.csv --out x | b.csv: position: 'x' holds too few numbers (2 in 2 rows
replay model.json one --out full | full: is a folder but not a bag
replay model.json one --out full --overwrite | full: is a folder but not a bag
replay model.json one --out one --overwrite | one: is an input, too
export model.json --out m.cpp | m.cpp: expected a name that ends in .ces (flat file of the C++ node) or .c (C99
export model.json --out m | m: expected a name that ends in .ces
export model.json --out m.c --sources-only | --sources-only applies to an FMU only
export model.json --out missing/m.fmu --sources-only | missing/m.fmu: the folder
export model.json --out missing/m.c | missing does not exist; make it first
export model.json --out math.c | not a standard header
export model.json --out m.c --name '2; x' | name '2; x': not usable in C; choose one such as 'model_2_x'
export model.json --out m.fmu --name '2; x' | name '2; x': not usable in C
export model.json --out taken.c | taken.c: exists; choose another name
export model.json --out head.c | head.h: exists; choose another name
export none.json --out m.c | no such model file
compare model.json one | one model given (model.json); taken as recordings: one
compare one | no model given; taken as recordings: one
compare model.json law:force one --report page.pdf | a report is an HTML page
compare model.json law:force | no recording given
compare model.json model.json one | model.json is given twice
compare model.json law:force one --report page.html | page.html: exists; choose another name
compare model.json law:force one --report model.json | model.json:
compare model.json law:force nowhere | nowhere
compare model.json nothing.json one | nothing.json: no such model file
compare model.json topic:/prediction one | no topic /prediction
compare model.json law:force one two --report empty | empty/model_and_law-force_on_one_and_two.html: exists
diagnose --sim law:force --real b.csv --out o | b.csv: position: 'x' holds too few numbers (2 in 2 rows
diagnose --sim law:force --real nowhere --out o | nowhere: no such file
diagnose --sim law:force --real x* --out o | x*: no bag matches
diagnose --sim nowhere.json --real one --out o | nowhere.json: no such model file
diagnose --sim what --real one --out o | 'what' is no simulation; expected MODEL.json, AUGMENTED.json
diagnose --sim law:force --real one one --out o | one: the same recording, twice under --real
diagnose --sim law:force --real one two --held-out two --out o | recordings must not be fitted
diagnose --sim law:force --real one two --reference two --out o | references must be free of
diagnose --sim law:force --real one --effects law:force --out o | not an effect
diagnose --sim law:force --real one --effects nowhere:Own --out o | cannot be imported
diagnose --sim law:force --real one --jobs 2 --out o | --jobs applies to fleets
diagnose --sim law:force --real one --each recording --held-out two --out o | --held-out has no effect with --each
diagnose --sim law:force --real one --each vehicle --overwrite --out o | --overwrite has no
diagnose --sim law:force --real one --seed -1 --out o | whole number from 0 to
diagnose --sim topic:/none --real one --out o | no topic /none; it has /joint_states
diagnose --sim broken.fmu --real one --out o | broken.fmu:
diagnose --sim law:force --real one --out taken | taken: is not a folder
diagnose --sim law:force --real one --each recording --out taken | taken: is not a folder
diagnose --sim law:force --real one --out full | full: exists; choose another name for --out
diagnose --sim law:raises --real one --out o | law:raises: raised RuntimeError: no licence
diagnose --sim law:nothing --real one --out o | law:nothing: returned nan at 0.000 s; expected finite forces
diagnose --sim law:short --real one --out o | law:short: returned shape (1999,); expected (2000,), one for each
diagnose --sim law:turned --real one --out o | opposite sign of the measured one (measured over simulated is
diagnose --sim law:force --real kN --out o | the measured force is in kN
diagnose --sim law:force --real one --reference kN --out o | expected one unit: is one of them in kN or kip?
diagnose --sim law:force --real clipped --out o | force: the channel saturates
diagnose --sim law:force --real loose --out o | the measured force is constant
diagnose --sim law:force --real s03 --out o | 75 position samples; expected at least 100
diagnose --sim law:force --real s06 --out o | s with position, current, force and a simulated force together
diagnose --sim law:force --real s3 --out o | s remain for the fit; expected at least 4 s
diagnose --sim narrow.json --real one --out o | narrow.json: outside the range it was identified on for 100%
diagnose --identify --real one --out o | --identify needs --reference
diagnose --identify --sim m.json --reference two --real one --out o | --sim does not apply with --identify
diagnose --real one --out o | no simulation: give --sim SIM, or --identify
diagnose --real one --each recording --out o | no simulation: give --sim SIM, or --identify
diagnose --sim model.json --structure hydraulic --real one --out o | --structure applies to --identify
blind | the following arguments are required: make|run|score
blind make --out x --seed 1 --effects magic | --effects: invalid choice: 'magic'
blind make --out x --seed 1 --kind odd | --kind: invalid choice: 'odd'
blind make --out . --seed 1 --cases 1 | .: exists; choose another name for --out, or replace it with
blind make --out full --seed 1 --cases 1 --overwrite | more than blind cases (note)
blind run x --out y --simulation identified --references 0 | add --references 5
blind run nowhere --out y | nowhere: contains no cases/NNNN/case.json
blind run full --out taken | taken: is not a folder
blind score nowhere y | nowhere: not a sealed blind test
info nowhere | nowhere: no such file
info cut.mcap | cut.mcap:
info torn_bag | the file ends early
info empty.mcap | empty.mcap
info none | none
info other | no topic 'joint_states' for position; the bag has /other (std_msgs/msg/Float64)
info one --signals front.yaml | front_damper
info still | still: position: constant at 0.01 m
info spotted | position: 667 of 2000 samples are NaN
info infinite --json | force: 2000 of 2000 samples are NaN or infinite
signals nowhere | nowhere
signals README.md | README.md
signals empty | no bag in this folder
import | expected
import a.csv | expected
import a.csv --propose --out o | ces import: error:
import log.csv --propose --json | --json does not apply with --propose, which prints a mapping
import --template --out o | --out does not apply with --template
import one --out o | one: a bag needs no import: ces info one
import one/one.mcap --out o | one/one.mcap: a bag needs no import: ces info one/one.mcap
import b.csv --mapping signals.yaml --out o | is a signals file (--signals); --mapping takes a mapping of columns
import b.csv a.csv --mapping map.yaml --out o | a.csv:3: column 'F' is 'oops'; expected a number
import b.csv sub/b.csv --mapping map.yaml --out o | 2 files are named 'b'
import b.csv --mapping map.yaml --out one | one: exists; choose another name for --out, or replace it with --overwrite
import b.csv --mapping map.yaml --out o --signals load.yaml | give the log's scale in map.yaml, and none here
export-data one --out taken.csv | taken.csv: exists; choose another name
export-data one --out run.xlsx | expected a name that ends in .csv, .parquet, .pq, or a folder
export-data one --out run.csv --format parquet | is a csv file by its name; omit --format
export-data one --out run.csv --model none.json | none.json
export-data one two --out one.csv | 2 bags need a folder, which gets a file for each
export-data other --out other.csv | 'ces signals
characterise one --model none.json | none.json
characterise one --model a:b --model a:b | given twice
characterise one --out full | or replace it with --overwrite
rig none.yaml --out x | none.yaml: no such file or packaged experiment
rig | expected EXPERIMENT and --out BAG
rig sweep | expected EXPERIMENT and --out BAG
rig sweep --out x --seed -1 | expected a whole number from 0 to 2147483648
rig sine_4hz --out full | full: is a folder but not a bag
rig --list --seed 1 | --seed does not apply with --list
iterate i1.yaml --out o | limits is [1, 2]; expected a mapping of keys to values
iterate i2.yaml --out o | expected one of virtual, folder, ros
iterate i3.yaml --out o | budget_s is -3
iterate i4.yaml --out o | missing
iterate i5.yaml --out o | not valid YAML
iterate i6.yaml --out taken | is not a folder
iterate --template plan.yaml | PLAN does not apply with --template
schema signals --list | NAME does not apply with --list
schema --list --path | --path does not apply with --list
schema signals --json | --json applies to --list
serve nowhere --port 0 | no such folder
serve taken --port 0 | is not a folder
serve empty --host 203.0.113.7 | unrecognized arguments: --host
serve empty --port 0 --signals none.yaml | none.yaml
"""
ROWS = [tuple(row.split(" | ")) for row in TABLE.splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, shared_model: SharedResults) -> Iterator[Path]:
    """The working folder."""
    here = tmp_path_factory.mktemp("bad_inputs")
    fill_with_mistakes(here, shared_model)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        patch.syspath_prepend(here)
        patch.setattr("ces_cli.terminal.heartbeat.QUIET_S", 1e6)  # else a busy computer logs progress
        yield here


@pytest.mark.parametrize(("words", "expected"), ROWS, ids=[row[0] for row in ROWS])
@pytest.mark.slow
def test_a_mistake_is_one_line_and_writes_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], words: str, expected: str
) -> None:
    before = snapshot(folder)
    line = error_line(capsys, *shlex.split(words))
    assert ": error: " in line and expected in line
    assert snapshot(folder) == before


@pytest.fixture(autouse=True)
def without_what_was_written(folder: Path) -> Iterator[None]:
    """Remove what a program wrote in spite of a mistake, so that it does not disturb the next."""
    before = snapshot(folder)
    yield
    for path in snapshot(folder).keys() - before.keys():
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def snapshot(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if "__pycache__" not in path.parts}
