"""One source, two installations: `pip install .` gives the program `ces`, `colcon build` what `ros2 run` finds."""

import sys
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))  # both modules below need the standard library only

from ces_cli.main import PROGRAMS  # noqa: E402
from ces_observer import __version__  # noqa: E402

NAME = "ces_observer"
# colcon and ROS's Debian and RPM rules run this file as a program; pip and other front ends call it through a backend.
FOR_ROS = "setuptools.build_meta" not in sys.modules
ROS_PROGRAMS = [
    f"observer = {NAME}.nodes.observer:main",
    f"controller = {NAME}.nodes.controller:main",
    *(f"{program} = ces_cli.ros_program:main" for program in PROGRAMS),
]


def files(folder: str, *patterns: str) -> tuple[str, list[str]]:
    """Return a data_files entry: what matches `patterns` in `folder`, for share/ces_observer/`folder`."""
    found = (str(path.relative_to(HERE)) for pattern in patterns for path in (HERE / folder).glob(pattern))
    return f"share/{NAME}/{folder}", sorted(found)


def security() -> list[tuple[str, list[str]]]:
    """Return data_files entries for all folders of config/security, which hold the policies of SROS 2."""
    root = HERE / "config" / "security"
    folders = [root, *(path for path in sorted(root.rglob("*")) if path.is_dir())]
    return [files(str(folder.relative_to(HERE)), "*.*") for folder in folders]


readme = HERE / "README.md"

setup(
    name=NAME,
    version=__version__,
    description="Identify models of semi-active dampers from rig recordings and run them as force observers on ROS 2",
    long_description=readme.read_text(encoding="utf-8") if readme.exists() else "",
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=["ces_*"]),
    package_data={
        "*": ["py.typed"],
        "ces_identify": ["**/*.yaml", "**/*.j2", "**/*.html", "**/*.css", "**/*.js", "**/*.hpp", "**/*.cpp"],
        "ces_cli": ["**/*.j2", "**/*.css"],
        "ces_rig": ["**/*.yaml"],
        "ces_iterate": ["**/*.j2", "**/*.css"],
        "ces_gap": ["**/*.json", "**/*.j2", "**/*.css"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        files("launch", "*.launch.py"),
        files("config", "*.yaml", "*.json", "*.xml"),
        files("config/models", "*.*"),
        files("config/thesis", "*.yaml"),
        *security(),
    ],
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "numba>=0.58",
        "matplotlib>=3.6",
        "jinja2>=3.1",
        "rich>=13",
        "PyYAML>=6",
        "rosbags>=0.11",
        "mcap>=1.1",  # with lz4 and zstandard
        "zstandard>=0.15",
        "joblib>=1.3",
    ],
    extras_require={
        "bench": ["joblib>=1.4", "sysidentpy>=0.9", "fastcan>=0.6", "anfis-toolbox>=0.2"],  # the peers in bench/
        "fuzz": ["atheris>=2.3"],  # coverage-guided fuzzing: bench/fuzz/guided.py
        "fmi": ["fmpy>=0.3.20"],  # to run an FMU; writing one needs a C compiler only
        "test": ["pytest>=7.4"],  # by which colcon test knows its runner
        "dask": ["distributed>=2022.12"],  # for campaigns on a cluster: ces identify --campaign --dask
        "docs": ["mkdocs-material>=9.5", "mkdocstrings[python]>=0.26", "ruff>=0.6"],  # make docs
        "dev": [
            "pytest>=7.4",
            "pytest-xdist>=3.4",
            "hypothesis>=6.98",
            "distributed>=2022.12",
            "fmpy>=0.3.20",
            "ruff>=0.6",
            "mypy>=1.11",
            "playwright>=1.40",  # drives the Chromium of the system in tests of pages
            "types-PyYAML",
        ],
    },
    zip_safe=True,
    entry_points={"console_scripts": ROS_PROGRAMS if FOR_ROS else ["ces = ces_cli.main:main"]},
)
