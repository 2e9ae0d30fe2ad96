"""More small aircraft in the styles in which people publish theirs; see `foreign_aircraft`.

All are written for these tests.
"""

from __future__ import annotations

from tests.helpers.foreign_aircraft import (
    FIXED_AIRSCREW,
    FLAT_FOUR,
    GEAR,
    POSITIONS,
    aerodynamics,
    airframe,
    config,
    surface,
)

TURBINE_SHAFT = """<?xml version="1.0"?>
<turboprop_engine name="shaft">
  <milthrust unit="LBS">1500</milthrust>
  <idlen1>58</idlen1>
  <maxn1>100</maxn1>
  <maxpower unit="HP">600</maxpower>
  <psfc unit="LBS/HR/HP">0.6</psfc>
  <n1idle_max_delay>1</n1idle_max_delay>
  <maxstartingtime>20</maxstartingtime>
  <startern1>20</startern1>
  <ielumaxtorque unit="FT*LB">5000</ielumaxtorque>
  <itt_delay>0.05</itt_delay>
  <betarangeend>0</betarangeend>
  <reversemaxpower>0</reversemaxpower>
  <table name="EnginePowerVC">
    <independentVar lookup="row">atmosphere/P-psf</independentVar>
    <independentVar lookup="column">velocities/ve-kts</independentVar>
    <tableData>
             0     100   200
      1000   0.55  0.56  0.60
      2116   1.00  1.02  1.06
    </tableData>
  </table>
  <table name="EnginePowerRPM_N1" type="internal">
    <tableData>
            0    58    80   100
      0     0    20   150   420
      1200  0    25   230   560
      2200  0    20   250   600
    </tableData>
  </table>
  <table name="ITT_N1" type="internal">
    <tableData>
            0    1
      0     0    0
      58    180  500
      100   280  720
    </tableData>
  </table>
</turboprop_engine>
"""

GOVERNED_AIRSCREW = """<?xml version="1.0"?>
<propeller name="governed">
  <ixx unit="SLUG*FT2">4.0</ixx>
  <diameter unit="IN">96</diameter>
  <numblades>3</numblades>
  <gearratio>1.0</gearratio>
  <minpitch>12</minpitch>
  <maxpitch>45</maxpitch>
  <minrpm>1200</minrpm>
  <maxrpm>2100</maxrpm>
  <constspeed>1</constspeed>
  <table name="C_THRUST" type="internal">
    <tableData>
            12      45
      0.0   0.110   0.160
      0.5   0.050   0.150
      1.0  -0.060   0.120
      2.0  -0.200   0.020
    </tableData>
  </table>
  <table name="C_POWER" type="internal">
    <tableData>
            12      45
      0.0   0.050   0.330
      0.5   0.035   0.290
      1.0  -0.020   0.230
      2.0  -0.150   0.060
    </tableData>
  </table>
</propeller>
"""


def _turboprop() -> dict[str, str]:
    """Return a utility turboprop: condition lever, ground effect, coefficients of all axes."""
    ground = """  <function name="aero/function/ground-effect-lift">
    <table>
      <independentVar>aero/h_b-mac-ft</independentVar>
      <tableData>
        0.0 1.20
        0.5 1.03
        1.1 1.00
      </tableData>
    </table>
  </function>
"""
    lift = "<p>aero/function/ground-effect-lift</p><v>4.8</v>"
    aero = aerodynamics().replace("<aerodynamics>\n", f"<aerodynamics>\n{ground}")
    old = "<value>4.8</value>"
    assert old in aero
    aero = aero.replace(old, lift)
    system = """<?xml version="1.0"?>
<system name="levers">
  <channel name="Levers">
    <switch name="lever/condition">
      <default value="0"/>
      <test value="1"> /controls/engines/engine[0]/condition lt 0.1 </test>
      <output>propulsion/cutoff_cmd</output>
    </switch>
    <fcs_function name="lever/power">
      <function><product>
        <p>/controls/engines/engine[0]/throttle</p>
        <difference><v>1</v><p>/controls/engines/engine[0]/reverser</p></difference>
      </product></function>
      <output>fcs/throttle-cmd-norm[0]</output>
    </fcs_function>
    <pure_gain name="lever/speed">
      <input>/controls/engines/engine[0]/propeller-pitch</input>
      <gain>1</gain>
      <output>fcs/advance-cmd-norm[0]</output>
    </pure_gain>
  </channel>
</system>
"""
    propulsion = (
        """<propulsion>
  <engine file="shaft">
    <location unit="IN"><x>-20</x><y>0</y><z>0</z></location>
    <feed>0</feed><feed>1</feed>
    <thruster file="governed">
      <location unit="IN"><x>-40</x><y>0</y><z>0</z></location>
      <sense>1</sense>
      <p_factor>4</p_factor>
    </thruster>
  </engine>
"""
        + "\n".join(
            f"""  <tank type="FUEL" number="{k}">
    <location unit="IN"><x>42</x><y>{y}</y><z>10</z></location>
    <capacity unit="LBS">500</capacity><contents unit="LBS">300</contents>
  </tank>"""
            for k, y in enumerate((-60, 60))
        )
        + "\n</propulsion>"
    )
    control = "\n".join(
        [
            '<flight_control name="turboprop">',
            '  <channel name="Surfaces">',
            surface("pitch/elevator", "fcs/elevator-cmd-norm", POSITIONS["elevator"]),
            surface("roll/aileron", "fcs/aileron-cmd-norm", POSITIONS["aileron"]),
            surface("yaw/rudder", "fcs/rudder-cmd-norm", POSITIONS["rudder"]),
            "  </channel>",
            "</flight_control>",
        ]
    )
    body = "\n".join(
        [
            airframe(
                wing=(280.0, 52.0, 5.6),
                inertia=(9000.0, 9500.0, 16000.0),
                weight_lbs=5200.0,
                gear=GEAR,
            ),
            propulsion,
            '<system file="levers"/>',
            control,
            aero,
        ]
    )
    return {
        "turboprop.xml": config("turboprop", body),
        "Engines/shaft.xml": TURBINE_SHAFT,
        "Engines/governed.xml": GOVERNED_AIRSCREW,
        "Systems/levers.xml": system,
    }


def _tail_dragger() -> dict[str, str]:
    """Return a biplane with pushback, canopy, pedal mix and tail wheel, moved by its host."""
    system = """<?xml version="1.0"?>
<system name="ground">
  <channel name="Pushback">
    <fcs_function name="pushback/force">
      <function><product>
        <p>/sim/model/pushback/linked</p>
        <p>/gear/gear[0]/wow</p>
        <sum>
          <product><p>/sim/model/pushback/kp</p>
            <difference><v>0</v><p>/gear/gear[0]/rollspeed-ms</p></difference></product>
          <p>/sim/model/pushback/target-speed-fps</p>
        </sum>
      </product></function>
    </fcs_function>
  </channel>
  <channel name="Canopy">
    <actuator name="canopy/position">
      <input>/sim/model/canopy/open</input>
      <rate_limit>0.5</rate_limit>
    </actuator>
  </channel>
</system>
"""
    control = "\n".join(
        [
            '<flight_control name="biplane">',
            '  <channel name="Surfaces">',
            surface("pitch/elevator", "/controls/flight/elevator", POSITIONS["elevator"]),
            surface("roll/aileron", "/controls/flight/aileron", POSITIONS["aileron"]),
            """    <fcs_function name="yaw/mix">
      <function><sum>
        <p>/controls/flight/rudder</p>
        <product><v>0.2</v><p>/options/autocoordinate</p><p>/controls/flight/aileron</p></product>
      </sum></function>
    </fcs_function>""",
            surface("yaw/rudder", "yaw/mix", POSITIONS["rudder"]),
            """    <switch name="yaw/tail-wheel">
      <default value="0"/>
      <test value="fcs/rudder-cmd-norm"> /controls/gear/tailwheel-lock eq 0 </test>
      <output>fcs/steer-cmd-norm</output>
    </switch>""",
            "  </channel>",
            "</flight_control>",
        ]
    )
    reactions = """<external_reactions>
  <force name="pushback" frame="BODY">
    <function><p>pushback/force</p></function>
    <location unit="IN"><x>0</x><y>0</y><z>-40</z></location>
    <direction><x>1</x><y>0</y><z>0</z></direction>
  </force>
</external_reactions>"""
    drag = """  <axis name="DRAG">
    <function name="aero/coefficient/CDcanopy"><product>
      <p>aero/qbar-psf</p><p>metrics/Sw-sqft</p><v>0.01</v><p>canopy/position</p>
    </product></function>"""
    propulsion = """<propulsion>
  <engine file="radial">
    <location unit="IN"><x>0</x><y>0</y><z>0</z></location>
    <feed>0</feed>
    <thruster file="wooden">
      <location unit="IN"><x>-12</x><y>0</y><z>0</z></location>
      <sense>1</sense><p_factor>3</p_factor>
    </thruster>
  </engine>
  <tank type="FUEL">
    <location unit="IN"><x>30</x><y>0</y><z>5</z></location>
    <capacity unit="LBS">150</capacity><contents unit="LBS">100</contents>
  </tank>
</propulsion>"""
    body = "\n".join(
        [
            airframe(wing=(220.0, 30.0, 3.8), weight_lbs=1800.0, gear=GEAR),
            propulsion,
            '<system file="ground"/>',
            control,
            reactions,
            aerodynamics().replace('  <axis name="DRAG">', drag),
        ]
    )
    return {
        "biplane.xml": config("biplane", body),
        "Engines/radial.xml": FLAT_FOUR.replace("flat_four", "radial"),
        "Engines/wooden.xml": FIXED_AIRSCREW.replace("fixed_airscrew", "wooden"),
        "Systems/ground.xml": system,
    }


STYLES = {"turboprop": _turboprop, "biplane": _tail_dragger}
SPEEDS_MPS = {"turboprop": 55.0, "biplane": 42.0}
