"""Small aircraft in the styles in which people publish theirs: each reads what a host provides.

All are written for these tests. `write` makes the folder of one of `STYLES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

POSITIONS = {
    "elevator": "fcs/elevator-pos-rad",
    "aileron": "fcs/left-aileron-pos-rad",
    "rudder": "fcs/rudder-pos-rad",
}


def product(*factors: str | float) -> str:
    """Return a <product> of properties and numbers."""
    parts = [
        f"<value>{f}</value>" if not isinstance(f, str) else f"<property>{f}</property>"
        for f in factors
    ]
    return f"<product>{''.join(parts)}</product>"


def _axis(axis: str, length: str | None, terms: Mapping[str, tuple[str | float, ...]]) -> str:
    scale = ("aero/qbar-psf", "metrics/Sw-sqft") + ((length,) if length else ())
    functions = "\n".join(
        f'    <function name="aero/{axis.lower()}/{name}">{product(*scale, *factors)}</function>'
        for name, factors in terms.items()
    )
    return f'  <axis name="{axis}">\n{functions}\n  </axis>'


def aerodynamics(positions: Mapping[str, str] = POSITIONS) -> str:
    """Return an ordinary wing with tail, whose surfaces are the given properties [rad]."""
    b, c = "metrics/bw-ft", "metrics/cbarw-ft"
    bi, ci = "aero/bi2vel", "aero/ci2vel"
    p, q, r = (f"velocities/{axis}-aero-rad_sec" for axis in "pqr")
    elevator, aileron, rudder = (positions[name] for name in ("elevator", "aileron", "rudder"))
    axes = [
        _axis("DRAG", None, {"zero": (0.03,), "induced": (0.05, "aero/cl-squared")}),
        _axis("SIDE", None, {"beta": (-0.4, "aero/beta-rad"), "rudder": (0.15, rudder)}),
        _axis(
            "LIFT", None, {"zero": (0.3,), "alpha": (4.8, "aero/alpha-rad"), "de": (0.4, elevator)}
        ),
        _axis(
            "ROLL",
            b,
            {
                "beta": (-0.09, "aero/beta-rad"),
                "p": (-0.45, bi, p),
                "r": (0.1, bi, r),
                "da": (0.17, aileron),
            },
        ),
        _axis(
            "PITCH",
            c,
            {
                "zero": (0.04,),
                "alpha": (-0.9, "aero/alpha-rad"),
                "q": (-12.0, ci, q),
                "de": (-1.1, elevator),
            },
        ),
        _axis(
            "YAW", b, {"beta": (0.065, "aero/beta-rad"), "r": (-0.1, bi, r), "dr": (-0.06, rudder)}
        ),
    ]
    return "<aerodynamics>\n" + "\n".join(axes) + "\n</aerodynamics>"


def airframe(
    *,
    wing: tuple[float, float, float] = (174.0, 36.0, 4.9),
    inertia: tuple[float, float, float] = (950.0, 1350.0, 1970.0),
    weight_lbs: float = 2000.0,
    gear: str = "",
) -> str:
    """Return metrics, mass and gear: wing area [ft2], span and chord [ft]."""
    area, span, chord = wing
    ixx, iyy, izz = inertia
    return f"""<metrics>
  <wingarea unit="FT2">{area}</wingarea>
  <wingspan unit="FT">{span}</wingspan>
  <chord unit="FT">{chord}</chord>
  <location name="AERORP" unit="IN"><x>40</x><y>0</y><z>0</z></location>
  <location name="EYEPOINT" unit="IN"><x>30</x><y>0</y><z>20</z></location>
  <location name="VRP" unit="IN"><x>0</x><y>0</y><z>0</z></location>
</metrics>
<mass_balance>
  <ixx unit="SLUG*FT2">{ixx}</ixx>
  <iyy unit="SLUG*FT2">{iyy}</iyy>
  <izz unit="SLUG*FT2">{izz}</izz>
  <emptywt unit="LBS">{weight_lbs}</emptywt>
  <location name="CG" unit="IN"><x>40</x><y>0</y><z>0</z></location>
</mass_balance>
<ground_reactions>
{gear}
</ground_reactions>"""


GEAR = """  <contact type="BOGEY" name="nose">
    <location unit="IN"><x>-5</x><y>0</y><z>-45</z></location>
    <static_friction>0.8</static_friction><dynamic_friction>0.5</dynamic_friction>
    <rolling_friction>0.02</rolling_friction>
    <spring_coeff unit="LBS/FT">1800</spring_coeff>
    <damping_coeff unit="LBS/FT/SEC">600</damping_coeff>
    <max_steer unit="DEG">10</max_steer><brake_group>NONE</brake_group><retractable>0</retractable>
  </contact>"""


def piston_propulsion(engines: int = 1) -> str:
    """Return propulsion with piston engines, a tank each."""
    parts = []
    for k in range(engines):
        y = 0.0 if engines == 1 else (-70.0, 70.0)[k]
        parts.append(f"""  <engine file="flat_four">
    <location unit="IN"><x>0</x><y>{y}</y><z>0</z></location>
    <feed>{k}</feed>
    <thruster file="fixed_airscrew">
      <location unit="IN"><x>-10</x><y>{y}</y><z>0</z></location>
      <sense>{1 if k == 0 else -1}</sense>
    </thruster>
  </engine>""")
    parts += [
        f"""  <tank type="FUEL" number="{k}">
    <location unit="IN"><x>45</x><y>{(-40, 40)[k % 2]}</y><z>10</z></location>
    <capacity unit="LBS">120</capacity><contents unit="LBS">90</contents>
  </tank>"""
        for k in range(engines)
    ]
    return "<propulsion>\n" + "\n".join(parts) + "\n</propulsion>"


FLAT_FOUR = """<?xml version="1.0"?>
<piston_engine name="flat_four">
  <minmp unit="INHG">6.5</minmp>
  <maxmp unit="INHG">28.5</maxmp>
  <displacement unit="IN3">320</displacement>
  <maxhp>160</maxhp>
  <cycles>4</cycles>
  <idlerpm>600</idlerpm>
  <maxthrottle>1.0</maxthrottle>
  <minthrottle>0.1</minthrottle>
</piston_engine>
"""

FIXED_AIRSCREW = """<?xml version="1.0"?>
<propeller name="fixed_airscrew">
  <ixx unit="SLUG*FT2">1.6</ixx>
  <diameter unit="IN">75</diameter>
  <numblades>2</numblades>
  <minpitch>20</minpitch>
  <maxpitch>20</maxpitch>
  <table name="C_THRUST" type="internal">
    <tableData>
      0.0  0.0700
      0.3  0.0620
      0.6  0.0440
      0.9  0.0120
      1.0  0.0000
      1.5 -0.0600
    </tableData>
  </table>
  <table name="C_POWER" type="internal">
    <tableData>
      0.0  0.0430
      0.3  0.0430
      0.6  0.0380
      0.9  0.0180
      1.0  0.0080
      1.5 -0.0500
    </tableData>
  </table>
</propeller>
"""

MOTOR = """<?xml version="1.0"?>
<electric_engine name="motor">
  <power unit="WATTS">400</power>
</electric_engine>
"""

SMALL_AIRSCREW = """<?xml version="1.0"?>
<propeller name="small_airscrew">
  <ixx unit="KG*M2">0.0004</ixx>
  <diameter unit="IN">11</diameter>
  <numblades>2</numblades>
  <minpitch>10</minpitch>
  <maxpitch>10</maxpitch>
  <table name="C_THRUST" type="internal">
    <tableData>
      0.0  0.0900
      0.4  0.0650
      0.8  0.0100
      1.2 -0.0500
    </tableData>
  </table>
  <table name="C_POWER" type="internal">
    <tableData>
      0.0  0.0450
      0.4  0.0420
      0.8  0.0200
      1.2 -0.0200
    </tableData>
  </table>
</propeller>
"""


def surface(name: str, command: str, output: str, reach: float = 0.35) -> str:
    """Return a component that scales a command to an angle [rad]."""
    return f"""    <aerosurface_scale name="{name}">
      <input>{command}</input>
      <range><min>{-reach}</min><max>{reach}</max></range>
      <output>{output}</output>
    </aerosurface_scale>"""


def config(name: str, body: str) -> str:
    """Return an aircraft file."""
    return f"""<?xml version="1.0"?>
<fdm_config name="{name}" version="2.0" release="ALPHA">
<fileheader><author>tests</author><description>A style of /controls/flight/x.</description>
</fileheader>
{body}
</fdm_config>
"""


SWITCHBOARD = """<?xml version="1.0"?>
<system name="switchboard">
  <channel name="Electrics">
    <switch name="electrics/live">
      <default value="0"/>
      <test value="1"> /controls/electric/battery-switch == 1
        /systems/electrical/serviceable == 1 </test>
    </switch>
  </channel>
  <channel name="Engine">
    <switch name="engine/magnetos-selected">
      <default value="0"/>
      <test value="/controls/engines/engine[0]/magnetos"> electrics/live == 1 </test>
      <output>propulsion/magneto_cmd</output>
    </switch>
    <switch name="engine/starter-on">
      <default value="0"/>
      <test value="1" logic="AND">
        /controls/engines/engine[0]/starter == 1
        electrics/live == 1
      </test>
      <output>propulsion/starter_cmd</output>
    </switch>
    <fcs_function name="engine/mixture">
      <function>
        <product>
          <property>/controls/engines/engine[0]/mixture</property>
          <difference>
            <value>1.0</value>
            <product><value>0.2</value><property>/controls/engines/engine[0]/primer</property></product>
          </difference>
        </product>
      </function>
      <output>fcs/mixture-cmd-norm[0]</output>
    </fcs_function>
    <fcs_function name="engine/cooling">
      <function><sum>
        <property>/controls/engines/engine[0]/cowl-flaps-norm</property>
        <property>/engines/engine[0]/oil-temperature-degf</property>
      </sum></function>
    </fcs_function>
  </channel>
</system>
"""


def _piston_single() -> dict[str, str]:
    control = "\n".join(
        [
            '<flight_control name="single">',
            '  <channel name="Pitch">',
            """    <summer name="pitch/sum">
      <input>/controls/flight/elevator</input>
      <input>/controls/flight/elevator-trim</input>
      <clipto><min>-1</min><max>1</max></clipto>
    </summer>""",
            surface("pitch/elevator", "pitch/sum", "fcs/elevator-pos-rad"),
            "  </channel>",
            '  <channel name="Lateral">',
            surface("roll/aileron", "/controls/flight/aileron", "fcs/left-aileron-pos-rad"),
            surface("yaw/rudder", "-/controls/flight/rudder", "fcs/rudder-pos-rad"),
            "  </channel>",
            '  <channel name="Doors">',
            """    <kinematic name="door/position">
      <input>/sim/model/door-positions/left/position-norm</input>
      <traverse>
        <setting><position>0</position><time>0</time></setting>
        <setting><position>1</position><time>2</time></setting>
      </traverse>
    </kinematic>""",
            "  </channel>",
            "</flight_control>",
        ]
    )
    body = "\n".join(
        [
            airframe(gear=GEAR),
            piston_propulsion(),
            '<system file="switchboard"/>',
            control,
            aerodynamics(),
        ]
    )
    return {
        "single.xml": config("single", body),
        "Engines/flat_four.xml": FLAT_FOUR,
        "Engines/fixed_airscrew.xml": FIXED_AIRSCREW,
        "Systems/switchboard.xml": SWITCHBOARD,
    }


def _glider() -> dict[str, str]:
    tow = """<system name="tow">
  <channel name="Tow">
    <switch name="tow/pull">
      <default value="0"/>
      <test value="120"> /sim/hitches/aerotow/open == 0
        /sim/hitches/aerotow/tow/connected == 1 </test>
    </switch>
  </channel>
</system>"""
    pull = """<external_reactions>
  <force name="hook" frame="BODY">
    <function><property>tow/pull</property></function>
    <location unit="IN"><x>0</x><y>0</y><z>0</z></location>
    <direction><x>1</x><y>0</y><z>0</z></direction>
  </force>
</external_reactions>"""
    control = "\n".join(
        [
            '<flight_control name="glider">',
            '  <channel name="All">',
            surface("pitch/elevator", "fcs/elevator-cmd-norm", "fcs/elevator-pos-rad"),
            surface("roll/aileron", "fcs/aileron-cmd-norm", "fcs/left-aileron-pos-rad"),
            surface("yaw/rudder", "fcs/rudder-cmd-norm", "fcs/rudder-pos-rad"),
            """    <fcs_function name="brake/height">
      <function><product>
        <property>/position/altitude-agl-ft</property>
        <property>/gear/gear[1]/wow</property>
      </product></function>
    </fcs_function>""",
            "  </channel>",
            "</flight_control>",
        ]
    )
    body = "\n".join(
        [
            airframe(wing=(150.0, 50.0, 3.1), inertia=(900.0, 500.0, 1350.0), weight_lbs=800.0),
            pull,
            tow,
            control,
            aerodynamics(),
        ]
    )
    return {"glider.xml": config("glider", body)}


SMALL = {"wing": (3.2, 3.9, 0.85), "inertia": (0.045, 0.05, 0.09), "weight_lbs": 3.3}


def _electric_foam() -> dict[str, str]:
    control = """<flight_control name="foam">
  <property value="0">uav/motor-command</property>
  <channel name="Mixer">
    <summer name="elevon/left">
      <input>fcs/elevator-cmd-norm</input>
      <input>fcs/aileron-cmd-norm</input>
      <clipto><min>-1</min><max>1</max></clipto>
    </summer>
    <summer name="elevon/right">
      <input>fcs/elevator-cmd-norm</input>
      <input>-fcs/aileron-cmd-norm</input>
      <clipto><min>-1</min><max>1</max></clipto>
    </summer>
    <fcs_function name="elevon/pitch">
      <function><product><value>0.175</value>
        <sum><property>elevon/left</property><property>elevon/right</property></sum>
      </product></function>
    </fcs_function>
    <fcs_function name="elevon/roll">
      <function><product><value>0.175</value>
        <difference><property>elevon/left</property><property>elevon/right</property></difference>
      </product></function>
    </fcs_function>
  </channel>
  <channel name="Motor">
    <actuator name="motor/speed-controller">
      <input>uav/motor-command</input>
      <lag>15</lag>
      <output>fcs/throttle-pos-norm</output>
    </actuator>
  </channel>
</flight_control>"""
    propulsion = """<propulsion>
  <engine file="motor">
    <location unit="IN"><x>50</x><y>0</y><z>0</z></location>
    <feed>0</feed>
    <thruster file="small_airscrew">
      <location unit="IN"><x>52</x><y>0</y><z>0</z></location>
      <sense>1</sense>
    </thruster>
  </engine>
  <tank type="FUEL" number="0">
    <location unit="IN"><x>40</x><y>0</y><z>0</z></location>
    <capacity unit="LBS">0.1</capacity><contents unit="LBS">0.1</contents>
  </tank>
</propulsion>"""
    positions = {"elevator": "elevon/pitch", "aileron": "elevon/roll", "rudder": "uav/fin-angle"}
    body = "\n".join(
        [
            airframe(**SMALL),  # type: ignore[arg-type]
            propulsion,
            control,
            aerodynamics(positions),
        ]
    )
    return {
        "wing.xml": config("wing", body),
        "Engines/motor.xml": MOTOR,
        "Engines/small_airscrew.xml": SMALL_AIRSCREW,
    }


def _twin() -> dict[str, str]:
    # FlightGear's controls are the inputs, and JSBSim's commands are computed from them.
    control = "\n".join(
        [
            '<flight_control name="twin">',
            '  <channel name="Pilot">',
            """    <pure_gain name="fcs/elevator-cmd-norm">
      <input>/controls/flight/elevator</input><gain>0.8</gain>
    </pure_gain>
    <pure_gain name="fcs/aileron-cmd-norm">
      <input>/controls/flight/aileron</input><gain>0.9</gain>
    </pure_gain>""",
            *(
                f"""    <pure_gain name="engine-{k}/lever">
      <input>/controls/engines/engine[{k}]/throttle</input><gain>0.95</gain>
      <output>fcs/throttle-cmd-norm[{k}]</output>
    </pure_gain>"""
                for k in (0, 1)
            ),
            surface("pitch/elevator", "fcs/elevator-cmd-norm", "fcs/elevator-pos-rad"),
            surface("roll/aileron", "fcs/aileron-cmd-norm", "fcs/left-aileron-pos-rad"),
            surface("yaw/rudder", "fcs/rudder-cmd-norm", "fcs/rudder-pos-rad"),
            """    <switch name="hydraulics/boost">
      <default value="0"/>
      <test value="1"> /systems/hydraulic/pressure-psi gt 1000 </test>
    </switch>
    <fcs_function name="fcs/boosted-rudder-rad">
      <function><product>
        <property>fcs/rudder-pos-rad</property><property>hydraulics/boost</property>
      </product></function>
    </fcs_function>""",
            "  </channel>",
            "</flight_control>",
        ]
    )
    body = "\n".join(
        [
            airframe(weight_lbs=2600.0, gear=GEAR),
            piston_propulsion(2),
            control,
            aerodynamics({**POSITIONS, "rudder": "fcs/boosted-rudder-rad"}),
        ]
    )
    return {
        "twin.xml": config("twin", body),
        "Engines/flat_four.xml": FLAT_FOUR,
        "Engines/fixed_airscrew.xml": FIXED_AIRSCREW,
    }


def _v_tail() -> dict[str, str]:
    control = """<flight_control name="vtail">
  <channel name="Tail">
    <summer name="tail/left">
      <input>fcs/elevator-cmd-norm</input><input>fcs/rudder-cmd-norm</input>
      <clipto><min>-1</min><max>1</max></clipto>
    </summer>
    <summer name="tail/right">
      <input>fcs/elevator-cmd-norm</input><input>-fcs/rudder-cmd-norm</input>
      <clipto><min>-1</min><max>1</max></clipto>
    </summer>
    <fcs_function name="tail/pitch">
      <function><product><value>0.17</value>
        <sum><property>tail/left</property><property>tail/right</property></sum>
      </product></function>
    </fcs_function>
    <fcs_function name="tail/yaw">
      <function><product><value>0.17</value>
        <difference><property>tail/left</property><property>tail/right</property></difference>
      </product></function>
    </fcs_function>
    <pure_gain name="wing/aileron">
      <input>fcs/aileron-cmd-norm</input><gain>0.3</gain>
    </pure_gain>
  </channel>
  <channel name="Prop">
    <property value="1">systems/esc/armed</property>
    <fcs_function name="esc/output">
      <function><product>
        <property>fcs/throttle-cmd-norm</property>
        <property>systems/esc/armed</property>
      </product></function>
      <output>fcs/throttle-pos-norm</output>
    </fcs_function>
  </channel>
</flight_control>"""
    propulsion = """<propulsion>
  <engine file="motor">
    <location unit="IN"><x>20</x><y>0</y><z>0</z></location>
    <thruster file="small_airscrew">
      <location unit="IN"><x>18</x><y>0</y><z>0</z></location>
    </thruster>
  </engine>
</propulsion>"""
    positions = {"elevator": "tail/pitch", "aileron": "wing/aileron", "rudder": "tail/yaw"}
    body = "\n".join(
        [
            airframe(**SMALL),  # type: ignore[arg-type]
            propulsion,
            control,
            aerodynamics(positions),
        ]
    )
    return {
        "vtail.xml": config("vtail", body),
        "Engines/motor.xml": MOTOR,
        "Engines/small_airscrew.xml": SMALL_AIRSCREW,
    }


TURBOFAN = """<?xml version="1.0"?>
<turbine_engine name="turbofan">
  <milthrust unit="LBS">3500</milthrust>
  <bypassratio>3.0</bypassratio>
  <tsfc>0.6</tsfc>
  <bleed>0.02</bleed>
  <idlen1>28</idlen1><idlen2>55</idlen2>
  <maxn1>100</maxn1><maxn2>100</maxn2>
  <augmented>0</augmented><injected>0</injected>
  <function name="IdleThrust"><value>0.06</value></function>
  <function name="MilThrust">
    <table>
      <independentVar lookup="row">velocities/mach</independentVar>
      <tableData>
        0.0 1.0
        0.4 0.8
        0.8 0.7
      </tableData>
    </table>
  </function>
</turbine_engine>
"""

HYDRAULICS = """<?xml version="1.0"?>
<system name="hydraulics">
  <channel name="Pressure">
    <switch name="systems/hydraulics/green/pressure-norm">
      <default value="0"/>
      <test value="1" logic="OR">
        /engines/engine[0]/n2 gt 40
        /systems/hydraulics/green/electric-pump-switch eq 1
      </test>
    </switch>
    <switch name="fbw/law-normal">
      <default value="0"/>
      <test value="1" logic="AND">
        /controls/FBW/selected-law eq 1
        systems/hydraulics/green/pressure-norm gt 0.5
      </test>
    </switch>
  </channel>
  <channel name="Levers">
    <pure_gain name="lever/left">
      <input>/controls/engines/engine[0]/throttle-fdm</input><gain>1</gain>
      <output>fcs/throttle-cmd-norm[0]</output>
    </pure_gain>
    <pure_gain name="lever/right">
      <input>/controls/engines/engine[1]/throttle-fdm</input><gain>1</gain>
      <output>fcs/throttle-cmd-norm[1]</output>
    </pure_gain>
    <switch name="fuel/cutoff">
      <default value="0"/>
      <test value="1"> /controls/engines/engine[0]/cutoff eq 1 </test>
      <output>propulsion/cutoff_cmd</output>
    </switch>
  </channel>
</system>
"""


def _business_jet() -> dict[str, str]:
    parts = [
        f"""  <engine file="turbofan">
    <location unit="IN"><x>80</x><y>{y}</y><z>10</z></location>
    <feed>0</feed>
    <thruster file="direct"><location unit="IN"><x>90</x><y>{y}</y><z>10</z></location></thruster>
  </engine>"""
        for y in (-50, 50)
    ]
    propulsion = "\n".join(
        [
            "<propulsion>",
            *parts,
            """  <tank type="FUEL" number="0">
    <location unit="IN"><x>42</x><y>0</y><z>0</z></location>
    <capacity unit="LBS">4000</capacity><contents unit="LBS">2500</contents>
  </tank>""",
            "</propulsion>",
        ]
    )
    powered = "\n".join(
        f"""    <fcs_function name="power/{name}">
      <function><product>
        <property>fcs/{name}-cmd-norm</property>
        <property>{"fbw/law-normal" if name == "elevator" else pressure}</property>
      </product></function>
    </fcs_function>
"""
        + surface(f"powered/{name}", f"power/{name}", POSITIONS[name])
        for name in POSITIONS
        for pressure in ("systems/hydraulics/green/pressure-norm",)
    )
    control = f"""<flight_control name="jet">
  <channel name="Powered">
{powered}
    <pure_gain name="spoiler/position">
      <input>/controls/flight/speedbrake</input><gain>1</gain>
      <output>fcs/speedbrake-pos-norm</output>
    </pure_gain>
  </channel>
</flight_control>"""
    body = "\n".join(
        [
            airframe(
                wing=(320.0, 50.0, 7.0), inertia=(14000.0, 28000.0, 40000.0), weight_lbs=10500.0
            ),
            propulsion,
            '<system file="hydraulics"/>',
            control,
            aerodynamics(),
        ]
    )
    return {
        "jet.xml": config("jet", body),
        "Engines/turbofan.xml": TURBOFAN,
        "Engines/direct.xml": '<?xml version="1.0"?>\n<direct name="direct"/>\n',
        "Systems/hydraulics.xml": HYDRAULICS,
    }


STYLES = {
    "single": _piston_single,
    "glider": _glider,
    "wing": _electric_foam,
    "twin": _twin,
    "vtail": _v_tail,
    "jet": _business_jet,
}
SPEEDS_MPS = {
    "single": 50.0,
    "glider": 28.0,
    "wing": 15.0,
    "twin": 60.0,
    "vtail": 15.0,
    "jet": 130.0,
}


def write(style: str, parent: Path) -> Path:
    """Write an aircraft into a folder of its name under ``parent`` and return the folder."""
    folder = parent / style
    for name, content in STYLES[style]().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")
    return folder
