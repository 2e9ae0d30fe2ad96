"""The components between commands and surface positions."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.xml.control_chain import ControlChain, ControlFiles, control_chain
from uqharness.xml.document import parse_document

SERVO = """<actuator name="fcs/elevator-pos-deg"><input>fcs/selected</input><lag> 25 </lag>
  <rate_limit>fcs/rate</rate_limit><!-- deg/s --></actuator>"""
SELECTOR = """<switch name="fcs/selected"><default value="fcs/elevator-cmd-deg"/><test logic="OR" value="fcs/other">
    ap/on == 1
    ap/held gt 0
  </test></switch>"""
GIVEN = ("fcs/elevator-cmd-deg",)


SPREAD = (
    '<distributor type="exclusive"><case><property'
    ' value="1">fcs/rate</property></case></distributor>'
)


def chain(
    servo: str = SERVO,
    selector: str = SELECTOR,
    more: str = "",
    aero: str = "",
    gate: str = "",
    engines: bool = False,
    wanted: str = "fcs/elevator-pos-deg",
    inputs: tuple[str, ...] = GIVEN,
) -> ControlChain | None:
    """The chain of an aircraft whose elevator goes through a selector and a servo."""
    xml = f"""<fdm_config><flight_control name="fc">
<property value="240">fcs/rate</property> <property value="0">ap/on</property> <property value="3">aero/Cm_q</property>
<channel name="one">{selector}<pure_gain name="Gear Horn"><input>velocities/vc-kts</input></pure_gain></channel>
<channel name="two" execrate="2"{gate}>{servo}</channel>{more}</flight_control>
<aerodynamics><function name="aero/lift"><property>aero/alpha-rad</property></function>{aero}</aerodynamics></fdm_config>"""
    document = parse_document(Path("a.xml"), xml.encode())
    systems = [node for node in document.root.children if node.tag == "flight_control"]
    return control_chain(ControlFiles(systems, [document], engines), [wanted], inputs)


def test_it_has_the_components_and_constants_that_make_a_position_and_no_others() -> None:
    result = chain()
    assert result is not None
    assert result.reads == {"fcs/elevator-cmd-deg", "fcs/other", "fcs/rate", "ap/on", "ap/held"}
    for part in (
        "<actuator",
        "<switch",
        'execrate="2"',
        '<property value="240">fcs/rate</property>',
        "ap/on == 1\nap/held gt 0",
    ):
        assert part in result.xml
    # What nothing declares is there all the same.
    assert '<property value="0">ap/held</property>' in result.xml
    for part in ("Gear Horn", "aero/Cm_q", "lift", "deg/s"):
        assert part not in result.xml


@pytest.mark.parametrize(
    "changes",
    [
        {"servo": SERVO.replace("fcs/rate", "aero/alpha-deg")},
        {"selector": SELECTOR.replace("ap/on == 1", "velocities/vc-kts gt 20")},
        {"selector": SELECTOR.replace("fcs/other", "position/h-agl-ft")},
        {"gate": ' execute="gear/wow"'},
        # What JSBSim computes is no constant because an XML says so.
        {
            "more": '<property value="0">attitude/phi-rad</property>',
            "servo": SERVO.replace("fcs/rate", "attitude/phi-rad"),
        },
        # A function may read anything.
        {"aero": '<function name="fcs/other"><property>aero/alpha-rad</property></function>'},
        {
            "aero": (
                '<function name="aero/more"'
                ' copyto="fcs/rate"><property>aero/alpha-rad</property></function>'
            )
        },
        {"servo": SERVO.replace("fcs/rate", "/fdm/jsbsim/fcs/rate")},
        # Which of two values holds is JSBSim's affair.
        {"more": '<property value="100">fcs/rate</property>'},
        {"more": f"<channel>{SPREAD}</channel>"},
        {
            "selector": (
                "<fcs_function"
                ' name="fcs/selected"><function><sum><random/></sum></function></fcs_function>'
            )
        },
        {"selector": '<sensor name="fcs/selected"><input>fcs/elevator-cmd-deg</input></sensor>'},
    ],
    ids=[
        "servo",
        "test",
        "value",
        "gate",
        "declared",
        "function",
        "copied",
        "absolute",
        "twice",
        "distributor",
        "random",
        "sensor",
    ],
)
def test_what_reads_or_may_read_the_motion_is_refused(changes: dict[str, str]) -> None:
    assert chain(**changes) is None


def test_an_engine_s_lever_goes_with_its_command() -> None:
    lever = {"wanted": "fcs/throttle-pos-norm", "inputs": ("fcs/throttle-cmd-norm",)}
    result = chain(engines=True, **lever)
    assert result is not None
    assert (
        '<pure_gain name="fcs/throttle-pos-norm"><input>fcs/throttle-cmd-norm</input></pure_gain>'
        in result.xml
    )
    assert chain(engines=True, wanted="fcs/throttle-pos-norm") is None
    assert chain(engines=True, wanted="fcs/mixture-pos-norm") is None
