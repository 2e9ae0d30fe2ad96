"""Aircraft from strangers: nothing is written, opened or imported for them; what JSBSim reads
belongs to their identity.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from uqharness.child_process import child_environment
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.aircraft import content_hash, find_aircraft, open_aircraft
from uqharness.simulator.mission import StagedMission
from uqharness.simulator.staging import (
    MAX_DEPTH,
    copy_folder,
    copy_shared_parts,
    screen_file,
    staged,
)

SCRIPT = """<?xml version="1.0"?>
<runscript name="s">
  <use aircraft="plane" initialize="{initialize}"/>
  {more}
  <run start="0" end="5" dt="0.01"/>
</runscript>
"""


@pytest.fixture
def plane(tmp_path: Path) -> Path:
    """A copy of a stock aircraft, in a folder of its own that is no JSBSim root."""
    folder = tmp_path / "plane"
    copy_folder(find_aircraft("c172x").folder, folder)
    (folder / "c172x.xml").rename(folder / "plane.xml")
    return folder


def write_value(folder: Path, elements: str, name: str = "plane.xml") -> None:
    """Elements as the last children of a file's root."""
    path = folder / name
    text = path.read_text(errors="surrogateescape")
    at = text.rindex("</")
    path.write_text(text[:at] + elements + text[at:], errors="surrogateescape")


def fly(folder: Path, frames: int = 20) -> Any:
    fdm = open_aircraft(find_aircraft(folder))
    fdm["ic/vt-kts"], fdm["ic/h-sl-ft"] = 90.0, 3000.0
    engine.run_ic(fdm)
    for _ in range(frames):
        fdm.run()
    return fdm


def files_below(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if path.is_file()}


def test_outputs_write_nothing_wherever_they_point(
    plane: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = (
        'type="CSV" rate="10"><property caption="&#10;touch'
        ' X&#10;#">position/h-sl-ft</property></output>'
    )
    write_value(
        plane,
        f'<output name="{tmp_path}/x.sh" {text}<output name="../../y.csv" {text}<output'
        f' file="{tmp_path}/z"/>',
    )
    before = files_below(tmp_path)
    with caplog.at_level("INFO", logger="uqharness"):
        fly(plane)
        fly(plane)
    assert files_below(tmp_path) == before
    (output,) = [record.message for record in caplog.records if str(plane) in record.message]
    assert "4 <output>" in output
    assert "left out" in output


def test_without_the_gate_the_same_file_writes(plane: Path, tmp_path: Path) -> None:
    """The attack is real: JSBSim alone does what the author asks."""
    write_value(
        plane,
        f'<output name="{tmp_path}/x.csv" type="CSV"'
        ' rate="10"><property>position/h-sl-ft</property></output>',
    )
    stock = engine.default_root()
    code = (
        "import jsbsim, sys; f = jsbsim.FGFDMExec(sys.argv[1]);"
        " f.set_aircraft_path(sys.argv[1]);f.set_engine_path(sys.argv[2]);"
        " f.set_systems_path(sys.argv[3]); f.load_model('plane'); f.run_ic(); f.run()"
    )
    subprocess.run(
        [sys.executable, "-c", code, tmp_path, stock / "engine", stock / "systems"],
        check=True,
        capture_output=True,
    )
    assert (tmp_path / "x.csv").is_file()


def test_no_socket_is_opened(plane: Path) -> None:
    with socket.socket() as listener, socket.socket() as free:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.settimeout(0.2)
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        write_value(
            plane,
            f'<input type="SOCKET" port="{port}"/><input type="QTJSBSIM" port="{port}"/><output'
            f' type="SOCKET" name="localhost" protocol="TCP" port="{listener.getsockname()[1]}"'
            ' rate="10"/>',
        )
        fly(plane)
        with pytest.raises(TimeoutError):
            listener.accept()
        with socket.socket() as other:
            other.bind(("127.0.0.1", port))


def test_a_state_asked_for_in_every_frame_is_not_written(
    plane: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_value(
        plane,
        '<system name="w"><channel name="c"><fcs_function'
        ' name="a/one"><function><value>1</value></function>'
        "<output>simulation/write-state-file</output></fcs_function></channel></system>",
    )
    before = files_below(tmp_path)
    fly(plane, frames=1000)
    assert files_below(tmp_path) == before
    assert not list(staged(find_aircraft(plane)).root.rglob("initfile*"))


def test_a_script_neither_writes_nor_listens(plane: Path, tmp_path: Path) -> None:
    shutil.copyfile(
        engine.default_root() / "aircraft" / "c172x" / "reset01.xml", plane / "start.xml"
    )
    script = tmp_path / "s.xml"
    more = (
        f'<input type="SOCKET" port="1137"/><output name="{tmp_path}/o.csv" type="CSV" rate="1"/>'
    )
    script.write_text(SCRIPT.format(initialize="start", more=more))
    before = files_below(tmp_path)
    with StagedMission(find_aircraft(plane), script) as mission:
        fdm = mission.open()
        engine.run_ic(fdm)
        fdm.run()
    assert files_below(tmp_path) == before
    for elsewhere in ("../start", f"{plane}/start", "..\\\\start"):
        script.write_text(SCRIPT.format(initialize=elsewhere, more=""))
        with pytest.raises(BadInputError, match="must lie in the aircraft's folder"):
            StagedMission(find_aircraft(plane), script)


@pytest.mark.parametrize(
    "element",
    [
        '<system file="/etc/passwd"/>',
        '<system file="a/../../outside"/>',
        '<propulsion><engine file="~/outside"/></propulsion>',
        '<aerodynamics file="C:\\\\outside"/>',
        '<autopilot file="\\\\\\\\host\\\\share"/>',
    ],
)
def test_a_file_outside_is_refused_with_its_line(plane: Path, element: str) -> None:
    write_value(plane, element)
    line = (plane / "plane.xml").read_text(errors="replace").count("\n")
    with pytest.raises(
        BadInputError, match=rf"plane\.xml:({line}|{line + 1}): .*leads out of the aircraft"
    ):
        fly(plane)


def test_a_second_aircraft_and_deep_nesting_are_refused(plane: Path) -> None:
    write_value(plane, '<child name="../../other"><location unit="IN"><x>0</x></location></child>')
    with pytest.raises(BadInputError, match="second aircraft"):
        fly(plane)
    deep = b"<a>" * (MAX_DEPTH + 1) + b"</a>" * (MAX_DEPTH + 1)
    with pytest.raises(BadInputError, match="nested more than"):
        screen_file(deep, "deep.xml")
    screen_file(b"<a>" * MAX_DEPTH + b"</a>" * MAX_DEPTH, "deep.xml")


def test_links_that_lead_out_are_refused(plane: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("secret")
    (plane / "notes.txt").symlink_to(secret)
    with pytest.raises(
        BadInputError, match=r"notes\.txt: is a link to .*outside the aircraft's folder"
    ):
        copy_folder(plane, tmp_path / "copy")
    with pytest.raises(BadInputError, match="outside the aircraft's folder"):
        fly(plane)
    (plane / "notes.txt").unlink()
    (plane / "gone.xml").symlink_to(plane / "nothing")
    with pytest.raises(BadInputError, match="leads nowhere"):
        fly(plane)
    (plane / "gone.xml").unlink()
    (plane / "loop").symlink_to(plane, target_is_directory=True)
    with pytest.raises(BadInputError, match="link to a folder"):
        fly(plane)
    (plane / "loop").unlink()
    (plane / "same.xml").symlink_to(plane / "plane.xml")
    fly(plane)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_in_the_folder_holds_nothing_up(plane: Path, tmp_path: Path) -> None:
    os.mkfifo(plane / "pipe.xml")
    with pytest.raises(BadInputError, match="is a pipe"):
        fly(plane)
    with pytest.raises(BadInputError, match="is a pipe"):
        copy_folder(plane, tmp_path / "copy")


def test_a_card_names_a_file_of_its_own_folder(plane: Path, tmp_path: Path) -> None:
    shutil.copyfile(plane / "plane.xml", tmp_path / "other.xml")
    message = "name of a file in this folder"
    for name, problem in (
        ("../other.xml", message),
        (str(tmp_path / "other.xml"), message),
        ("sub/other.xml", "does not exist"),
    ):
        (plane / "airframe.toml").write_text(f'[aircraft]\nname = "plane"\nxml = "{name}"\n')
        with pytest.raises(BadInputError, match=problem):
            find_aircraft(plane)


def root_with_engine(tmp_path: Path) -> Path:
    """A JSBSim root of the user's own: aircraft/plane, engine, systems."""
    folder = tmp_path / "root" / "aircraft" / "plane"
    copy_folder(find_aircraft("c172x").folder, folder)
    (folder / "c172x.xml").rename(folder / "plane.xml")
    copy_shared_parts(find_aircraft("c172x"), tmp_path / "root", stock=Path("elsewhere"))
    return folder


def test_engines_and_systems_beside_the_aircraft_belong_to_its_identity(tmp_path: Path) -> None:
    folder = root_with_engine(tmp_path)
    aircraft = find_aircraft(folder)
    assert aircraft.engine_path == tmp_path / "root" / "engine"
    engines = sorted((tmp_path / "root" / "engine").iterdir())
    assert engines
    before = content_hash(aircraft)
    for path in [*engines, *sorted((tmp_path / "root" / "systems").iterdir())]:
        text = path.read_bytes()
        path.write_bytes(text + b"\n")
        assert content_hash(aircraft) != before, path
        path.write_bytes(text)
    assert content_hash(aircraft) == before
    # What the aircraft does not use is no part of it.
    (tmp_path / "root" / "engine" / "unused.xml").write_text("<propeller/>")
    assert content_hash(aircraft) == before


def test_a_system_beside_that_changes_between_two_flights_is_flown_as_it_is(tmp_path: Path) -> None:
    folder = root_with_engine(tmp_path)
    system = tmp_path / "root" / "systems" / "GNCUtilities.xml"
    text = system.read_text()
    for value in (7, 8):
        at = text.rindex("</system>")
        system.write_text(f'{text[:at]}<property value="{value}">a/mark</property>{text[at:]}')
        assert fly(folder)["a/mark"] == value
    # One that comes to be where JSBSim looks first counts from then on.
    (folder / "Systems").mkdir()
    (folder / "Systems" / "GNCUtilities.xml").write_text(
        system.read_text().replace('value="8"', 'value="9"')
    )
    assert fly(folder)["a/mark"] == 9


@pytest.mark.parametrize("name", ["jsbsim", "socket"])
def test_python_files_of_the_working_folder_are_not_imported_by_children(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / f"{name}.py").write_text("open('imported', 'w')\nraise SystemExit(9)\n")
    command = [
        sys.executable,
        "-m",
        "uqharness.simulator.aircraft_checks",
        "/nowhere",
        "x.xml",
        "/nowhere",
        "/nowhere",
    ]
    done = subprocess.run(
        command, cwd=tmp_path, env=child_environment(), capture_output=True, text=True, check=False
    )
    assert (done.returncode, "refused" in done.stdout) == (0, True), done.stderr
    assert not (tmp_path / "imported").exists()


def test_without_that_environment_they_are(tmp_path: Path) -> None:
    (tmp_path / "jsbsim.py").write_text("open('imported', 'w')\nraise SystemExit(9)\n")
    command = [
        sys.executable,
        "-m",
        "uqharness.simulator.aircraft_checks",
        "/nowhere",
        "x.xml",
        "/nowhere",
        "/nowhere",
    ]
    environment = {k: v for k, v in child_environment().items() if k != "PYTHONSAFEPATH"}
    subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert (tmp_path / "imported").exists()
