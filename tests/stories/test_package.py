"""What a user installs: a wheel with everything in it that the commands look for, types,
docstrings, licence and citation.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from tests.helpers.places import ROOT
from uqharness.simulator import engine

yaml = pytest.importorskip("yaml")


def tracked(*folders: str) -> set[str]:
    """Files of a clean checkout under these folders: what lies there, less caches and results."""
    result = set()
    for folder in folders:
        for path in (ROOT / folder).rglob("*"):
            parts = path.relative_to(ROOT).parts
            # The package uqharness.results is none of the folders that runs leave.
            ran = parts[0] == "campaigns" and any(p.startswith("results") for p in parts)
            if path.is_file() and "__pycache__" not in parts and not ran:
                result.add("/".join(parts))
    return result


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project's wheel, built offline by the build backend of this environment."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


def test_the_wheel_holds_every_file_that_commands_look_for(wheel: Path):
    names = set(zipfile.ZipFile(wheel).namelist())
    inputs = {
        name for name in tracked("aircraft", "scripts", "campaigns") if not name.endswith(".py")
    }
    data = {f"uqharness/data/{name}" for name in inputs if not name.endswith(".parquet")}
    assert len(data) > 40
    assert data - names == set()
    assert tracked("sysid", "uqharness") - names == set()
    assert {
        "sysid/py.typed",
        "uqharness/py.typed",
        "sysid/logs/signal_maps/dataflash.toml",
    } <= names
    assert "uqharness/report/templates/page.html.j2" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert not any("shards" in name.split("/") or name.endswith(".parquet") for name in names)
    # Nothing that another distribution could own, and nobody's results.
    assert {name.split("/")[0].split("-")[0] for name in names} == {"sysid", "uqharness"}
    assert not any("results" in name.split("/")[2:] or "__pycache__" in name for name in names)


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution, unpacked."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("sdist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.tar.gz")
    with tarfile.open(built) as archive:
        archive.extractall(folder, filter="data")
    (unpacked,) = (path for path in folder.iterdir() if path.is_dir())
    return unpacked


@pytest.mark.slow
def test_the_sdist_gives_the_same_wheel(sdist: Path, wheel: Path, tmp_path: Path):
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=sdist, check=True, capture_output=True)
    (repeat,) = tmp_path.glob("*.whl")
    first, second = (
        {info.filename: info.CRC for info in zipfile.ZipFile(path).infolist()}
        for path in (wheel, repeat)
    )
    assert second == first
    # What a packager needs to test it.
    assert {"Makefile", "requirements.lock", "tests", "docs", "CHANGELOG.md"} <= {
        path.name for path in sdist.iterdir()
    }
    assert not (sdist / ".venv").exists()


def test_the_metadata_are_valid_and_name_the_versions_that_are_tested(wheel: Path):
    metadata = pytest.importorskip("packaging.metadata")
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        text = archive.read(name)
    result = metadata.Metadata.from_email(text, validate=True)
    assert result.description_content_type == "text/markdown"
    assert result.license_expression == "MIT"
    # Linux with Python 3.11 alone is tested; a classifier is a claim.
    versions = {
        c for c in result.classifiers if c.startswith("Programming Language :: Python :: 3.")
    }
    systems = {c for c in result.classifiers if c.startswith("Operating System")}
    assert versions == {"Programming Language :: Python :: 3.11"}
    assert systems == {"Operating System :: POSIX :: Linux"}
    reference = pytest.importorskip("trove_classifiers").classifiers
    assert set(result.classifiers) <= reference
    with pytest.raises(metadata.ExceptionGroup):
        metadata.Metadata.from_email(text.replace(b"Version: ", b"Version: not a "), validate=True)


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """bin of a fresh environment with the wheel in it, the dependencies borrowed from this one, the
    working copy out of sight.
    """
    folder = tmp_path_factory.mktemp("env")
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    command = ["--python", str(python), "install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run([sys.executable, "-m", "pip", *command], check=True, capture_output=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder), "platbase": str(folder)}))
    borrowed = [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    (site / "borrowed.pth").write_text("\n".join(borrowed) + "\n")
    # JSBSim looks for its own aircraft in the environment's folders alone.
    (site / "jsbsim").symlink_to(engine.default_root(), target_is_directory=True)
    return folder / "bin"


def run(installed: Path, folder: Path, *words: str) -> str:
    environment = {
        key: value for key, value in os.environ.items() if key not in {"PYTHONPATH", "PYTHONHOME"}
    }
    command = [installed / "uqharness", *words]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_installed_wheel_works_in_a_folder_of_its_own(installed: Path, tmp_path: Path):
    where = subprocess.run(
        [
            installed / "python",
            "-c",
            "import uqharness, sysid; print(uqharness.__file__, sysid.__file__)",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert str(ROOT / "uqharness") not in where
    assert where.count(str(installed.parent)) == 2
    modes = json.loads(
        run(installed, tmp_path, "modes", "espaaro", "--speed-mps", "22.2", "--json")
    )
    assert modes["trim"]["alpha_deg"] == pytest.approx(0.833, abs=0.01)
    run(
        installed,
        tmp_path,
        *shlex.split("fly espaaro_truth --script doublet-elevator --out doublet.csv"),
    )
    assert len((tmp_path / "doublet.csv").read_text().splitlines()) > 100
    # Two flights of the demonstration's 512, by name.
    part = [
        *shlex.split("campaign run demo --out part --hours 0.05 --shard 1/32 --serial"),
    ]
    assert "2 flights done" in run(installed, tmp_path, *part)


def test_citation_and_licence():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] == "software"
    assert citation["authors"]
    assert citation["license"] == "MIT"
    assert (ROOT / "LICENSE").read_text(encoding="utf-8").startswith("MIT License")
    from uqharness import __version__

    # What can be cited is the last release; a version under way has ".dev" in it.
    assert citation["version"] == __version__ or ".dev" in __version__


def test_what_every_spawned_process_reads_again_loads_nothing():
    """A worker of a campaign has no use for the command line: pandas, pyarrow and statistics would
    be 60 MB in each.
    """
    heavy = (
        "[name for name in ('uqharness.cli.main', 'numpy', 'pandas', 'pyarrow', 'scipy') if name in"
        " sys.modules]"
    )

    def loaded(module: str) -> list[str]:
        done = subprocess.run(
            [sys.executable, "-c", f"import sys, json, {module}; print(json.dumps({heavy}))"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        )
        return list(json.loads(done.stdout))

    assert 'uqharness = "uqharness.__main__:main"' in (ROOT / "pyproject.toml").read_text()
    assert loaded("uqharness.__main__") == []
    assert loaded("uqharness.cli.main, numpy") == ["uqharness.cli.main", "numpy"]
