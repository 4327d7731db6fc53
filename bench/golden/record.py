"""Runs the cases with the code of a checkout, and stores what they print and write as text that can be compared."""

from __future__ import annotations

import hashlib
import html
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

from bench.golden.cases import CASES, COMPARED, FILES, INPUTS, RENAMED, SERVED

ROOT = Path(__file__).resolve().parents[2]  # the inputs come from here, the code from the checkout
STARTUP = """\
import sys, time
# Modules that the checkout lacks must not come from an editable install of another one.
sys.meta_path[:] = [f for f in sys.meta_path if not getattr(f, "__module__", "").startswith("__editable__")]
def slow(clock):  # no search ends by time and no simulation counts as slow on a busy computer; durations print as 0
    return lambda: 1e-6 * clock()
time.monotonic, time.perf_counter, time.process_time = map(slow, (time.monotonic, time.perf_counter, time.process_time))
"""
MASKS = (
    (r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?( UTC|Z|[+-]\d\d:?\d\d)?)?", "<date>"),
    (r"\b[0-9a-f]{16,}\b|(?<=\w-)[0-9a-f]{8}\b", "<hash>"),
    (r"(ces_observer\D{0,12})\d+\.\d+\.\d+", r"\1<version>"),
)
TEXT = (".json", ".jsonl", ".csv", ".html", ".txt", ".md", ".yaml", ".xml", ".c", ".h", ".cpp", ".hpp", ".py", ".rst")
PAGES = 80  # of `ces serve`, at most


@dataclass(frozen=True)
class Recorder:
    """Records the code in `checkout`: `work` is where the programs run, `out` where the goldens go."""

    checkout: Path
    work: Path
    out: Path

    def record(self, names: list[str], jobs: int) -> None:
        (self.work / "startup").mkdir()
        (self.work / "startup" / "sitecustomize.py").write_text(STARTUP, encoding="utf-8")
        self._write_inputs()
        self.case("inputs", INPUTS)
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(lambda name: self.case(name, CASES[name]), [n for n in CASES if n in names]))
        if "serve" in names:
            self._serve()

    def _write_inputs(self) -> None:
        inputs = self.work / "inputs"
        shutil.copytree(ROOT / "bags", inputs / "bags")
        shutil.copytree(ROOT / "bench" / "fuzz" / "seeds" / "model", inputs / "models")
        shutil.copy(ROOT / "config" / "models" / "sample.json", inputs / "models")
        for name, text in FILES.items():
            (inputs / name).write_text(text, encoding="utf-8")

    def case(self, name: str, commands: tuple[str, ...]) -> None:
        """Run the commands of a case and store what they print and write."""
        began, folder = time.monotonic(), self.work / name
        folder.mkdir(exist_ok=True)
        before = set(folder.rglob("*"))
        for number, command in enumerate(commands, start=1):
            ran = self._ces(command, folder)
            told = f"$ ces {command}\nexit {ran.returncode}\n{ran.stdout}--- stderr\n{ran.stderr}"
            program = re.sub(r"\W+", "_", command.partition(" ")[0]) or "nothing"
            self._store(f"{name}/{number:02}_{program}.txt", told)
        for path in sorted(set(folder.rglob("*")) - before):
            if path.is_file() and not any(
                part.startswith((".", "__pycache__")) for part in path.relative_to(folder).parts
            ):
                for inner, text in _read(path):
                    self._store(f"{name}/{path.relative_to(folder)}{inner}", text)
        print(f"{name}: {len(commands)} commands, {time.monotonic() - began:.0f} s", flush=True)

    def _ces(self, command: str, folder: Path) -> subprocess.CompletedProcess[str]:
        words = shlex.split(command)
        if RENAMED.keys() & set(words):
            known = subprocess.run(self._words(words[0], "--help"), cwd=folder, env=self._environment(), text=True,
                                   capture_output=True, check=False).stdout.split()  # fmt: skip
            words = [RENAMED[w] if w in RENAMED and w not in known else w for w in words]
        return subprocess.run(self._words(*words), cwd=folder, env=self._environment(), text=True, capture_output=True,
                              stdin=subprocess.DEVNULL, check=False)  # fmt: skip

    def _words(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "ces_cli.main", *words]

    def _environment(self) -> dict[str, str]:
        one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        paths = os.pathsep.join(map(str, (self.work / "startup", self.checkout, self.work / "inputs")))
        return {
            **os.environ,
            **one,
            "PYTHONPATH": paths,
            "COLUMNS": "120",
            "NO_COLOR": "1",
            "TZ": "UTC",
            "LC_ALL": "C.UTF-8",
        }

    def _serve(self) -> None:
        """Store the pages of `ces serve` over results of the other cases, found by their links."""
        folder = self.work / "served"
        for path in SERVED:
            source = self.work / path
            if source.is_dir():
                shutil.copytree(source, folder / source.name)
            else:
                folder.mkdir(exist_ok=True)
                shutil.copy(source, folder)
        for path in folder.rglob("*"):
            os.utime(path, (1e9, 1e9))
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        words = self._words("serve", str(folder), "--port", "0")
        server = subprocess.Popen(words, cwd=self.work, env=self._environment(), **pipes)
        try:
            told = server.stdout.readline()
            self._fetch_pages(re.search(r"http://[^\s/]+", told)[0])
        finally:
            server.send_signal(signal.SIGINT)
            self._store("serve/terminal.txt", told + server.communicate(timeout=60)[0])

    def _fetch_pages(self, host: str) -> None:
        found = ["/", f"/compare?{COMPARED}", f"/compare/result?{COMPARED}", f"/events/compare?{COMPARED}"]
        for address in found:  # grows
            try:
                with urlopen(host + address, timeout=120) as answer:
                    kind, text = answer.headers.get_content_type(), answer.read().decode("utf-8", "replace")
            except HTTPError as error:
                kind, text = "text/html", f"{error.code}\n{error.read().decode()}"
            name = re.sub(r"[^\w.=-]+", "_", self._mask(address)).strip("_") or "overview"
            self._store(f"serve/{name}.html", _normalise_page(text) if kind == "text/html" else text)
            links = re.findall(r"""(?:href|data-work)="(/[^"#]*)""", text) + re.findall(r'"(/compare/[^"]*)"', text)
            fresh = (html.unescape(link) for link in links if not link.startswith("/assets"))
            found += [link for link in dict.fromkeys(fresh) if link not in found][: PAGES - len(found)]

    def _store(self, name: str, text: str) -> None:
        path, same = self.out / self._mask(name), 1
        while path.exists():  # names that differ in a hash alone
            same += 1
            path = (self.out / self._mask(name)).with_suffix(f".{same}{path.suffix}")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self._mask(text), encoding="utf-8")

    def _mask(self, text: str) -> str:
        text = (
            text.replace(str(self.work), "<work>").replace(str(self.checkout), "<tree>").replace(sys.prefix, "<python>")
        )
        for pattern, placeholder in MASKS:
            text = re.sub(pattern, placeholder, text)
        return text


def _read(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the texts in a written file, each with a suffix to the file's name."""
    if path.suffix == ".fmu":
        with zipfile.ZipFile(path) as archive:
            for name in sorted(archive.namelist()):
                if name.endswith(TEXT):
                    yield f"/{name}", archive.read(name).decode("utf-8")
    elif path.suffix == ".mcap":
        yield ".txt", _describe_bag(path.parent)
    elif path.suffix == ".html":
        yield "", _normalise_page(path.read_text(encoding="utf-8"))
    elif path.suffix == ".json":
        yield "", json.dumps(json.loads(path.read_text(encoding="utf-8")), indent=1, ensure_ascii=False)
    elif path.suffix in TEXT:
        yield "", path.read_text(encoding="utf-8")
    else:
        yield "", f"{path.suffix}: {path.stat().st_size > 0}"


def _normalise_page(text: str) -> str:
    """Return a page with a tag or a text per line, without styles and scripts."""
    text = re.sub(r"(<style[^>]*>).*?(</style>)", r"\1\2", text, flags=re.DOTALL)
    text = re.sub(r"(<script(?![^>]*json)[^>]*>).*?(</script>)", r"\1\2", text, flags=re.DOTALL)
    parts = (" ".join(part.split()) for part in re.split(r"(<[^>]+>)", text))
    return "\n".join(filter(None, parts)) + "\n"


def _describe_bag(folder: Path) -> str:
    """Return topic, type, count and digest of stamps and messages, for each topic of a bag."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    digests: dict[tuple[str, str], list] = {}
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
        for connection, stamp_ns, raw in bag.messages():
            row = digests.setdefault((connection.topic, connection.msgtype), [0, stamp_ns, stamp_ns, hashlib.sha256()])
            row[0], row[2] = row[0] + 1, stamp_ns
            row[3].update(stamp_ns.to_bytes(8, "little") + bytes(raw))
    return "".join(
        f"{topic} {kind}: {count} messages from {first} to {last} ns, digest {digest.hexdigest()[:12]}\n"
        for (topic, kind), (count, first, last, digest) in sorted(digests.items())
    )


def record(checkout: Path, out: Path, names: list[str], jobs: int) -> None:
    """Record the named cases of a checkout into a new folder."""
    with tempfile.TemporaryDirectory(prefix="golden_") as work:
        Recorder(checkout.resolve(), Path(work).resolve(), out.resolve()).record(names, jobs)
