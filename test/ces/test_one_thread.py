"""Where NumPy was imported before `ces`, as in notebooks, waiting threads of BLAS do not take cores from a search."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_blas_has_one_thread_while_a_model_is_identified():
    script = (
        "import sys; sys.path.insert(0, 'test/ces'); import numpy; from threadpoolctl import threadpool_info\n"
        "import ces, ces_identify.scripting.model as scripting; from test_door import QUICK, columns\n"
        "blas = lambda: {pool['num_threads'] for pool in threadpool_info() if pool['user_api'] == 'blas'}\n"
        "search = scripting.identify\n"
        "scripting.identify = lambda *given, **more: print('within', blas()) or search(*given, **more)\n"
        "before = blas(); ces.identify(columns(), **QUICK); assert blas() == before, blas()\n"
    )
    unset = {name: text for name, text in os.environ.items() if not name.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", script]
    ended = subprocess.run(command, check=False, cwd=ROOT, env=unset, text=True, capture_output=True)
    assert (ended.returncode, ended.stdout) == (0, "within {1}\n"), ended.stderr
