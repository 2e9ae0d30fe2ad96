"""More small aircraft in the styles in which people publish theirs; see `foreign_aircraft`.

All are written for these tests.
"""

from __future__ import annotations

from tests.helpers.foreign_aircraft import (
    FIXED_AIRSCREW,
    FLAT_FOUR,
    GEAR,
    MOTOR,
    POSITIONS,
    SMALL,
    SMALL_AIRSCREW,
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


BIG_PISTON = """<?xml version="1.0"?>
<piston_engine name="big_piston">
  <minmp unit="INHG">8</minmp>
  <maxmp unit="INHG">29.5</maxmp>
  <displacement unit="IN3">985</displacement>
  <maxhp>450</maxhp>
  <cycles>4</cycles>
  <idlerpm>550</idlerpm>
  <maxrpm>2300</maxrpm>
  <bore unit="IN">5.2</bore>
  <stroke unit="IN">5.2</stroke>
  <cylinders>9</cylinders>
  <compression-ratio>6.0</compression-ratio>
  <sparkfaildrop>0.05</sparkfaildrop>
  <numboostspeeds>1</numboostspeeds>
  <ratedboost1 unit="PSI">2.0</ratedboost1>
  <ratedpower1 unit="HP">450</ratedpower1>
  <ratedrpm1>2300</ratedrpm1>
  <ratedaltitude1 unit="FT">5000</ratedaltitude1>
</piston_engine>
"""


def _retractable() -> dict[str, str]:
    """Return a single with governor, retractable gear, flaps, fuel selector and wing leveller."""
    system = """<?xml version="1.0"?>
<system name="cockpit">
  <property value="0">/autopilot/locks/wing-leveler</property>
  <channel name="Fuel">
    <switch name="fuel/left-open">
      <default value="0"/>
      <test value="1" logic="OR">
        /controls/fuel/tank-selector == 0
        /controls/fuel/tank-selector == 2
      </test>
      <output>propulsion/tank[0]/priority</output>
    </switch>
    <switch name="ignition/position">
      <default value="/controls/engines/engine[0]/magnetos"/>
      <output>propulsion/magneto_cmd</output>
    </switch>
  </channel>
  <channel name="Leveller">
    <property value="0.4">ap/roll-gain</property>
    <pid name="ap/roll-pid">
      <input>-attitude/phi-rad</input>
      <kp>ap/roll-gain</kp>
      <ki>0.02</ki>
      <clipto><min>-0.3</min><max>0.3</max></clipto>
    </pid>
    <switch name="ap/aileron">
      <default value="0"/>
      <test value="ap/roll-pid"> /autopilot/locks/wing-leveler == 1 </test>
    </switch>
  </channel>
</system>
"""
    control = "\n".join(
        [
            '<flight_control name="retractable">',
            '  <channel name="Roll">',
            """    <summer name="roll/sum">
      <input>/controls/flight/aileron</input><input>ap/aileron</input>
      <clipto><min>-1</min><max>1</max></clipto>
    </summer>""",
            surface("roll/aileron", "roll/sum", POSITIONS["aileron"]),
            "  </channel>",
            '  <channel name="Pitch">',
            """    <summer name="pitch/sum">
      <input>fcs/elevator-cmd-norm</input><input>fcs/pitch-trim-cmd-norm</input>
      <clipto><min>-1</min><max>1</max></clipto>
    </summer>""",
            surface("pitch/elevator", "pitch/sum", POSITIONS["elevator"]),
            surface("yaw/rudder", "fcs/rudder-cmd-norm", POSITIONS["rudder"]),
            "  </channel>",
            '  <channel name="Gear and flaps">',
            """    <kinematic name="gear/drive">
      <input>gear/gear-cmd-norm</input>
      <traverse>
        <setting><position>0</position><time>0</time></setting>
        <setting><position>1</position><time>5</time></setting>
      </traverse>
      <output>gear/gear-pos-norm</output>
    </kinematic>
    <kinematic name="flap/drive">
      <input>/controls/flight/flaps</input>
      <traverse>
        <setting><position>0</position><time>0</time></setting>
        <setting><position>20</position><time>3</time></setting>
      </traverse>
      <output>fcs/flap-pos-deg</output>
    </kinematic>
    <fcs_function name="instrument/gear-lamp">
      <function><eq><p>/gear/gear[0]/position-norm</p><v>1</v></eq></function>
    </fcs_function>""",
            "  </channel>",
            "</flight_control>",
        ]
    )
    propulsion = (
        """<propulsion>
  <engine file="big_piston">
    <location unit="IN"><x>-10</x><y>0</y><z>0</z></location>
    <feed>0</feed><feed>1</feed>
    <thruster file="governed">
      <location unit="IN"><x>-30</x><y>0</y><z>0</z></location>
      <sense>1</sense>
    </thruster>
  </engine>
"""
        + "\n".join(
            f"""  <tank type="FUEL" number="{k}">
    <location unit="M"><x>1.1</x><y>{y}</y><z>0.2</z></location>
    <capacity unit="KG">100</capacity><contents unit="KG">70</contents>
  </tank>"""
            for k, y in enumerate((-1.5, 1.5))
        )
        + "\n</propulsion>"
    )
    drag = """  <axis name="DRAG">
    <function name="aero/coefficient/CDgear"><product>
      <p>aero/qbar-psf</p><p>metrics/Sw-sqft</p><v>0.015</v><p>gear/gear-pos-norm</p>
    </product></function>
    <function name="aero/coefficient/CDflap"><product>
      <p>aero/qbar-psf</p><p>metrics/Sw-sqft</p><v>0.002</v><p>fcs/flap-pos-deg</p>
    </product></function>"""
    aero = aerodynamics().replace('  <axis name="DRAG">', drag)
    gear = GEAR.replace("<retractable>0", "<retractable>1")
    body = "\n".join(
        [
            airframe(weight_lbs=2900.0, inertia=(1500.0, 2100.0, 3200.0), gear=gear),
            propulsion,
            '<system file="cockpit"/>',
            control,
            aero,
        ]
    )
    return {
        "retractable.xml": config("retractable", body),
        "Engines/big_piston.xml": BIG_PISTON,
        "Engines/governed.xml": GOVERNED_AIRSCREW,
        "Systems/cockpit.xml": system,
    }


def _pusher_wing() -> dict[str, str]:
    """Return an electric flying wing with a pusher, winglet rudders and its mixer in a system."""
    mixer = """<?xml version="1.0"?>
<system name="mixer">
  <channel name="Mixer" execrate="2">
    <fcs_function name="mix/left">
      <function><sum>
        <product><v>0.6</v><p>/controls/flight/elevator</p></product>
        <product><v>0.4</v><p>/controls/flight/aileron</p></product>
      </sum></function>
    </fcs_function>
    <fcs_function name="mix/right">
      <function><difference>
        <product><v>0.6</v><p>/controls/flight/elevator</p></product>
        <product><v>0.4</v><p>/controls/flight/aileron</p></product>
      </difference></function>
    </fcs_function>
    <actuator name="servo/left">
      <input>mix/left</input><lag>20</lag><rate_limit>6</rate_limit>
      <clipto><min>-0.5</min><max>0.5</max></clipto>
    </actuator>
    <actuator name="servo/right">
      <input>mix/right</input><lag>20</lag><rate_limit>6</rate_limit>
      <clipto><min>-0.5</min><max>0.5</max></clipto>
    </actuator>
    <actuator name="servo/winglets">
      <input>/controls/flight/rudder</input><lag>20</lag>
      <clipto><min>-0.4</min><max>0.4</max></clipto>
    </actuator>
    <fcs_function name="elevons/sum">
      <function><avg><p>servo/left</p><p>servo/right</p></avg></function>
    </fcs_function>
    <fcs_function name="elevons/difference">
      <function><product><v>0.5</v>
        <difference><p>servo/left</p><p>servo/right</p></difference></product></function>
    </fcs_function>
  </channel>
  <channel name="Speed controller">
    <switch name="esc/throttle">
      <default value="0"/>
      <test value="/controls/engines/engine[0]/throttle">
        /controls/engines/engine[0]/master eq 1
      </test>
      <output>fcs/throttle-cmd-norm</output>
    </switch>
  </channel>
</system>
"""
    propulsion = """<propulsion>
  <engine file="motor">
    <location unit="M"><x>1.2</x><y>0</y><z>0</z></location>
    <feed>0</feed>
    <thruster file="small_airscrew">
      <location unit="M"><x>1.25</x><y>0</y><z>0</z></location>
      <sense>-1</sense>
    </thruster>
  </engine>
  <tank type="FUEL">
    <location unit="M"><x>1.0</x><y>0</y><z>0</z></location>
    <capacity unit="KG">0.05</capacity><contents unit="KG">0.05</contents>
  </tank>
</propulsion>"""
    positions = {
        "elevator": "elevons/sum",
        "aileron": "elevons/difference",
        "rudder": "servo/winglets",
    }
    body = "\n".join(
        [
            airframe(**SMALL),  # type: ignore[arg-type]
            propulsion,
            '<system file="mixer.xml"/>',
            '<flight_control name="none"/>',
            aerodynamics(positions),
        ]
    )
    return {
        "pusher.xml": config("pusher", body),
        "Engines/motor.xml": MOTOR,
        "Engines/small_airscrew.xml": SMALL_AIRSCREW,
        "Systems/mixer.xml": mixer,
    }


def _ducted_fan() -> dict[str, str]:
    """Return a model jet: a ducted fan as electric engine with tank, and a stick with exponent."""
    fan = SMALL_AIRSCREW.replace("small_airscrew", "fan").replace(">11<", ">8<")
    control = """<flight_control name="ducted">
  <channel name="Stick">
    <fcs_function name="stick/pitch">
      <function><product><v>0.35</v><sum>
        <product><v>0.6</v><p>fcs/elevator-cmd-norm</p></product>
        <product><v>0.4</v>
          <pow><p>fcs/elevator-cmd-norm</p><v>3</v></pow></product>
      </sum></product></function>
      <output>fcs/elevator-pos-rad</output>
    </fcs_function>
    <scheduled_gain name="stick/roll">
      <input>fcs/aileron-cmd-norm</input>
      <gain>0.35</gain>
      <table>
        <independentVar>/velocities/airspeed-kt</independentVar>
        <tableData>
          0    1.0
          80   0.6
        </tableData>
      </table>
      <output>fcs/left-aileron-pos-rad</output>
    </scheduled_gain>
    <lag_filter name="stick/yaw">
      <input>fcs/rudder-cmd-norm</input><c1>25</c1>
    </lag_filter>
    <pure_gain name="stick/yaw-angle">
      <input>stick/yaw</input><gain>0.35</gain>
      <output>fcs/rudder-pos-rad</output>
    </pure_gain>
  </channel>
  <channel name="Fan">
    <fcs_function name="fan/output">
      <function><product>
        <p>fcs/throttle-cmd-norm</p>
        <difference><v>1</v><p>/sim/crashed</p></difference>
      </product></function>
      <output>fcs/throttle-pos-norm</output>
    </fcs_function>
  </channel>
</flight_control>"""
    propulsion = """<propulsion>
  <engine file="fan_motor">
    <location unit="IN"><x>45</x><y>0</y><z>0</z></location>
    <feed>0</feed>
    <thruster file="fan">
      <location unit="IN"><x>46</x><y>0</y><z>0</z></location>
      <sense>1</sense>
    </thruster>
  </engine>
  <tank type="FUEL">
    <location unit="IN"><x>40</x><y>0</y><z>0</z></location>
    <capacity unit="LBS">0.2</capacity><contents unit="LBS">0.2</contents>
  </tank>
</propulsion>"""
    body = "\n".join(
        [airframe(**SMALL), propulsion, control, aerodynamics()]  # type: ignore[arg-type]
    )
    return {
        "ducted.xml": config("ducted", body),
        "Engines/fan_motor.xml": MOTOR.replace('"motor"', '"fan_motor"').replace("400", "1500"),
        "Engines/fan.xml": fan,
    }


def _contra() -> dict[str, str]:
    """Return a racer with two engines on one axis whose propellers turn against each other."""
    parts = [
        f"""  <engine file="big_piston">
    <location unit="IN"><x>{-5 - 10 * k}</x><y>0</y><z>0</z></location>
    <feed>{k}</feed>
    <thruster file="governed">
      <location unit="IN"><x>{-40 - 8 * k}</x><y>0</y><z>0</z></location>
      <sense>{1 - 2 * k}</sense>
    </thruster>
  </engine>"""
        for k in (0, 1)
    ]
    tanks = [
        f"""  <tank type="FUEL" number="{k}">
    <location unit="IN"><x>42</x><y>0</y><z>{10 * k}</z></location>
    <capacity unit="LBS">240</capacity><contents unit="LBS">200</contents>
    <priority>1</priority>
  </tank>"""
        for k in (0, 1)
    ]
    # One lever for both engines.
    levers = "\n".join(
        f"""    <pure_gain name="lever/{kind}-{k}">
      <input>/controls/engines/engine[0]/{kind}</input><gain>1</gain>
      <output>fcs/{command}-cmd-norm[{k}]</output>
    </pure_gain>"""
        for kind, command in (("throttle", "throttle"), ("mixture", "mixture"))
        for k in (0, 1)
    )
    control = "\n".join(
        [
            '<flight_control name="contra">',
            f'  <channel name="Levers">\n{levers}\n  </channel>',
            '  <channel name="Surfaces">',
            surface("pitch/elevator", "fcs/elevator-cmd-norm", POSITIONS["elevator"]),
            surface("roll/aileron", "fcs/aileron-cmd-norm", POSITIONS["aileron"]),
            """    <summer name="yaw/pedals">
      <input>fcs/rudder-cmd-norm</input><input>/controls/flight/rudder-trim</input>
      <clipto><min>-1</min><max>1</max></clipto>
    </summer>""",
            surface("yaw/rudder", "yaw/pedals", POSITIONS["rudder"]),
            "  </channel>",
            "</flight_control>",
        ]
    )
    body = "\n".join(
        [
            airframe(weight_lbs=4400.0, inertia=(3000.0, 5200.0, 7600.0), gear=GEAR),
            "<propulsion>\n" + "\n".join([*parts, *tanks]) + "\n</propulsion>",
            control,
            aerodynamics(),
        ]
    )
    return {
        "contra.xml": config("contra", body),
        "Engines/big_piston.xml": BIG_PISTON,
        "Engines/governed.xml": GOVERNED_AIRSCREW,
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


STYLES = {
    "turboprop": _turboprop,
    "retractable": _retractable,
    "pusher": _pusher_wing,
    "ducted": _ducted_fan,
    "contra": _contra,
    "biplane": _tail_dragger,
}
SPEEDS_MPS = {
    "turboprop": 55.0,
    "retractable": 58.0,
    "pusher": 15.0,
    "ducted": 18.0,
    "contra": 70.0,
    "biplane": 42.0,
}
