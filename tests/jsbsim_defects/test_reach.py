"""What a model's XML can reach outside itself in JSBSim 1.3.3: docs/jsbsim-traps.md, "Access to
files and network".
"""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from tests.jsbsim_defects.small_models import load, small, write_model

LOCAL = "127.0.0.1"
ANOTHER_LOCAL = "127.0.0.2"
"""Also this machine on Linux: answers there mean that all addresses are listened on."""


def with_elements(root: Path, elements: str) -> Path:
    write_model(root)
    xml = root / "aircraft" / "small" / "small.xml"
    xml.write_text(xml.read_text().replace("</fdm_config>", f"{elements}</fdm_config>"))
    return root


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])


def test_an_output_is_written_wherever_its_name_points(tmp_path: Path) -> None:
    caption = 'caption="&#10;any text of the author&#10;"'
    element = (
        f"<output name='{tmp_path}/else.sh' type='CSV' rate='10'><property"
        f" {caption}>position/h-sl-ft</property></output>"
    )
    fdm = load(with_elements(tmp_path / "root", element))
    fdm.set_output_path(str(tmp_path / "nowhere"))
    fdm.run_ic()
    fdm.run()
    assert "\nany text of the author\n" in (tmp_path / "else.sh").read_text()


def test_an_input_listens_on_all_addresses(tmp_path: Path) -> None:
    port = free_port()
    fdm = load(with_elements(tmp_path, f"<input type='SOCKET' port='{port}'/>"))
    fdm.run_ic()
    with socket.create_connection((ANOTHER_LOCAL, port), timeout=5):
        pass
    # Without the element nobody answers.
    del fdm
    calm = load(with_elements(tmp_path / "quiet", ""))
    calm.run_ic()
    with pytest.raises(OSError):
        socket.create_connection((LOCAL, free_port()), timeout=5)


def test_an_output_connects_to_a_machine_of_the_authors_choice(tmp_path: Path) -> None:
    with socket.socket() as listener:
        listener.bind((LOCAL, 0))
        listener.listen()
        listener.settimeout(10)
        element = (
            "<output type='SOCKET' name='localhost' protocol='TCP'"
            f" port='{listener.getsockname()[1]}' rate='10'/>"
        )
        fdm = load(with_elements(tmp_path, element))
        fdm.run_ic()
        listener.accept()[0].close()


def test_a_component_writes_a_state_file_in_every_frame(tmp_path: Path) -> None:
    one = "<function><value>1</value></function><output>simulation/write-state-file</output>"
    channel = f"<channel name='c'><fcs_function name='a/one'>{one}</fcs_function></channel>"
    fdm = small(tmp_path, fcs=channel)
    for name, files in (("aircraft", 10), ("nowhere", 0)):
        # The cure: an output path that does not exist.
        fdm.set_output_path(str(tmp_path / name))
        fdm.run_ic()
        for _ in range(9):
            fdm.run()
        result = list(tmp_path.rglob("initfile*"))
        assert len(result) == files
        for path in result:
            path.unlink()


def test_an_included_file_may_lie_anywhere(tmp_path: Path) -> None:
    (tmp_path / "else.xml").write_text(
        '<system name="s"><property value="7">else/mark</property></system>'
    )
    fdm = load(with_elements(tmp_path / "root", f'<system file="{tmp_path}/else.xml"/>'))
    assert fdm["else/mark"] == 7.0
