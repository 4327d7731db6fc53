"""One source, two installations: `pip install .` gives the program `ces`, `colcon build` what `ros2 run` finds."""

import sys
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py
from setuptools.command.install import install

from distutils.errors import CCompilerError, DistutilsError  # isort: skip
from distutils.command.install_data import install_data  # isort: skip; setuptools brings distutils

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))  # the modules below need the standard library only

from ces_cli.main import PROGRAMS  # noqa: E402
from ces_identify.export.c_printer import C_FLAGS, write_extension  # noqa: E402
from ces_observer import __version__  # noqa: E402

NAME = "ces_observer"
# colcon and ROS's Debian and RPM rules run this file as a program; pip and other front ends call it through a backend.
FOR_ROS = "setuptools.build_meta" not in sys.modules
MDF, MAT73, PARQUET = ["asammdf>=8.0"], ["h5py>=3.8"], ["pyarrow>=14"]  # formats of logs, each optional
TDMS, WORKBOOK = ["nptdms>=1.7"], ["openpyxl>=3.1", "matplotlib>=3.6"]
CAN = ["cantools>=39.4", "python-can>=4.3"]
ROS_PROGRAMS = [
    f"observer = {NAME}.nodes.observer:main",
    f"controller = {NAME}.nodes.controller:main",
    *(f"{program} = ces_cli.main:run_for_ros" for program in PROGRAMS),
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


class BuildWithSchemas(build_py):
    """Builds the packages with the JSON Schemas, where what makes them can be imported (not in pip's isolation)."""

    def run(self):
        super().run()
        try:
            from ces_cli.schema import write_schemas
        except ImportError:  # numpy and the like: `ces` makes the schemas when it first needs them
            return
        if not self.editable_mode:
            write_schemas(Path(self.build_lib) / "ces_identify" / "schemas")


class BuildCore(build_ext):
    """Builds the compiled core, from C that is printed from the tick now; without a C compiler there is none."""

    def build_extension(self, ext):
        folder = Path(self.build_temp)
        ext.sources, ext.include_dirs = write_extension(folder), [str(folder)]
        try:
            super().build_extension(ext)
        except (CCompilerError, DistutilsError):
            print("no compiled core, for want of a C compiler or Python.h: the tick runs in Python", file=sys.stderr)


class InstallInOneFolder(install):
    """Installs beside what ROS looks for, also where lib64 is another folder: the compiled core may be absent."""

    def finalize_options(self):
        super().finalize_options()
        if FOR_ROS:
            self.install_lib = self.install_purelib


class InstallWithSchemas(install_data):
    """Installs the schemas also where the first lines of config/*.yaml look for them."""

    def run(self):
        built = Path(self.get_finalized_command("build_py").build_lib) / "ces_identify" / "schemas"
        self.data_files.append((f"share/{NAME}/ces_identify/schemas", [str(path) for path in built.glob("*.json")]))
        super().run()


readme = HERE / "README.md"

setup(
    name=NAME,
    version=__version__,
    description="Identify models of semi-active dampers from rig recordings and run them as force observers on ROS 2",
    long_description=readme.read_text(encoding="utf-8") if readme.exists() else "",
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=["ces", "ces_*"]),
    cmdclass={
        "build_py": BuildWithSchemas,
        "build_ext": BuildCore,
        "install": InstallInOneFolder,
        "install_data": InstallWithSchemas,
    },
    ext_modules=[Extension(f"{NAME}._tick", sources=[], extra_compile_args=["-O2", *C_FLAGS], optional=True)],
    package_data={
        "*": ["py.typed"],
        "ces_identify": [
            "**/*.yaml",
            "**/*.c",
            "**/*.j2",
            "**/*.html",
            "**/*.css",
            "**/*.js",
        ],
        "ces_report": ["*.j2", "*.css", "*.js"],
        "ces_cli": ["**/*.j2", "**/*.css", "desk/templates/*"],
        "ces_rig": ["**/*.yaml", "**/*.j2"],
        "ces_data": ["**/*.yaml"],
        "ces_gap": ["**/*.json", "**/*.j2", "**/*.css"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        files("launch", "*.launch.py"),
        files("config", "*.yaml", "*.json", "*.xml"),
        files("config/import", "*.yaml"),
        files("config/models", "*.*"),
        files("config/thesis", "*.yaml"),
        *security(),
    ],
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "numba>=0.58",
        "jinja2>=3.1",
        "rich>=13",
        "PyYAML>=6",
        "rosbags>=0.11",
        "mcap>=1.1",  # with lz4 and zstandard
        "zstandard>=0.15",
        "joblib>=1.3",
        "threadpoolctl>=3.1",
    ],
    extras_require={
        "bench": [
            "joblib>=1.4",
            "sysidentpy>=0.9",
            "fastcan>=0.6",
            "matplotlib>=3.6",
        ],  # the peers in bench/
        "mdf": MDF,  # ces import FILE.mf4
        "mat73": MAT73,  # ces import FILE.mat, saved with -v7.3
        "can": CAN,  # ces import FILE.blf with a DBC
        "tdms": TDMS,  # ces import FILE.tdms, of LabVIEW
        "parquet": PARQUET,  # ces import FILE.parquet, ces export-data --out FILE.parquet
        "formats": [*MDF, *MAT73, *CAN, *TDMS, *PARQUET],
        "frames": ["pandas>=2.1"],  # DataFrames in and out of import ces
        "workbook": WORKBOOK,  # ces characterise --out: tables as .xlsx, charts as PNG
        "fmi": ["fmpy>=0.3.20"],  # to run an FMU; writing one needs a C compiler only
        "test": ["pytest>=7.4"],  # by which colcon test knows its runner
        "serve": ["flask>=3.0", "plotly>=5.4"],  # ces serve
        "notebook": ["notebook>=7", "ipykernel>=6.25", "matplotlib>=3.6", "pandas>=2.1"],  # examples/own_data.ipynb
        "docs": ["mkdocs-material>=9.5", "ruff>=0.6"],  # make docs
        "dev": [
            "pytest>=7.4",
            "pytest-xdist>=3.4",
            "setuptools>=64",  # what setup.py hands to it is tested
            "hypothesis>=6.98",
            "fmpy>=0.3.20",
            *MDF,
            *MAT73,
            *CAN,
            *TDMS,
            *PARQUET,
            "flask>=3.0",
            "plotly>=5.4",
            "ruff>=0.6",
            "mypy>=1.11",
            "playwright>=1.40",  # drives the Chromium of the system in tests of pages
            "jsonschema>=4.17",
            "types-jsonschema",
            "nbclient>=0.8",
            "nbformat>=5.9",
            *WORKBOOK,  # matplotlib is the notebook's, too, and that of make tables
            "ipykernel>=6.25",
            "types-PyYAML",
        ],
    },
    zip_safe=True,
    entry_points={"console_scripts": ROS_PROGRAMS if FOR_ROS else ["ces = ces_cli.main:main"]},
)
