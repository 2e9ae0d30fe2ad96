"""The program inside an exported FMU: JSBSim stepped by an FMI 3.0 co-simulation master.

It runs without uqharness; the importing program's Python needs the package jsbsim. Beside it are
``model.json`` (the aircraft, its integration step, commands, trimmed state and parameters) and
``settling.py``, the module of uqharness.simulator.
"""

import json
import math
from pathlib import Path

import jsbsim
import settling
from pythonfmu3 import Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability

OUTPUTS = {
    "V_mps": ("velocities/vt-fps", "ft", "true airspeed"),
    "alpha_rad": ("aero/alpha-rad", "", "angle of attack"),
    "beta_rad": ("aero/beta-rad", "", "sideslip, positive with wind from the right"),
    "phi_rad": ("attitude/phi-rad", "", "bank angle"),
    "theta_rad": ("attitude/theta-rad", "", "pitch angle"),
    "psi_rad": ("attitude/psi-rad", "", "heading"),
    "p_radps": ("velocities/p-rad_sec", "", "roll rate"),
    "q_radps": ("velocities/q-rad_sec", "", "pitch rate"),
    "r_radps": ("velocities/r-rad_sec", "", "yaw rate"),
    "ax_mps2": ("accelerations/a-pilot-x-ft_sec2", "ft", "specific force forward, at EYEPOINT"),
    "ay_mps2": ("accelerations/a-pilot-y-ft_sec2", "ft", "specific force right, at EYEPOINT"),
    "az_mps2": ("accelerations/a-pilot-z-ft_sec2", "ft", "specific force down, at EYEPOINT"),
    "vn_mps": ("velocities/v-north-fps", "ft", "ground velocity north"),
    "ve_mps": ("velocities/v-east-fps", "ft", "ground velocity east"),
    "vd_mps": ("velocities/v-down-fps", "ft", "ground velocity down"),
    "latitude_rad": ("position/lat-geod-rad", "", "geodetic latitude"),
    "longitude_rad": ("position/long-gc-rad", "", "longitude"),
    "h_m": ("position/h-sl-ft", "ft", "height above sea level"),
}
WIND = {
    "wind_north_mps": "atmosphere/wind-north-fps",
    "wind_east_mps": "atmosphere/wind-east-fps",
    "wind_down_mps": "atmosphere/wind-down-fps",
}


class Aircraft(Fmi3Slave):
    """A JSBSim aircraft that starts in its trim."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.folder = Path(str(self.resources).removeprefix("file://"))
        self.model = json.loads((self.folder / "model.json").read_text(encoding="utf-8"))
        self.modelName = self.model["identifier"]
        self.description = self.model["description"]
        self.fdm = None
        self.frames = 0
        self.values = {}
        self.time = 0.0
        self.register_variable(
            Float64(
                "time",
                causality=Fmi3Causality.independent,
                variability=Fmi3Variability.continuous,
                description="simulated time",
            )
        )
        for row in self.model["commands"]:
            self._add(row["name"], row["start"], Fmi3Causality.input, row["description"])
        for name in WIND:
            self._add(name, 0.0, Fmi3Causality.input, "velocity of the air")
        for row in self.model["parameters"]:
            self._add(row["name"], row["start"], Fmi3Causality.parameter, row["property"])
        self.factors = {"": 1.0, "ft": self.model["metres_per_foot"]}
        for name, (_, _, description) in OUTPUTS.items():
            self._add(name, 0.0, Fmi3Causality.output, description)

    def _add(self, name, start, causality, description):
        """Register a variable whose value stands in `values`."""
        self.values[name] = start
        variability = Fmi3Variability.continuous
        if causality == Fmi3Causality.parameter:
            variability = Fmi3Variability.tunable
        self.register_variable(
            Float64(
                name,
                causality=causality,
                variability=variability,
                description=description,
                getter=lambda: self.values[name],
                setter=lambda value: self.values.__setitem__(name, value),
            ),
            nested=False,
        )

    def exit_initialization_mode(self):
        """Load the aircraft and put it into its trim."""
        fdm = jsbsim.FGFDMExec(str(self.folder / "root"))
        fdm.set_debug_level(0)
        fdm.set_dt(self.model["dt_s"])
        if not fdm.load_model(self.model["aircraft"]):
            raise RuntimeError(f"JSBSim cannot load {self.model['aircraft']}")
        for name, value in self.model["initial"].items():
            fdm[name] = value
        self.fdm = fdm
        self._command()
        fdm.run_ic()
        # Mixtures and propellers as in the trim: rich and fine.
        fdm["propulsion/set-running"] = -1
        for k in range(fdm.get_propulsion().get_num_engines()):
            for lever in ("mixture", "advance"):
                fdm[f"fcs/{lever}-cmd-norm[{k}]"] = 1.0
        self._command()
        self._stand(2.0)
        fdm.get_propulsion().get_steady_state()
        self._stand(0.0)
        # JSBSim's own method leaves many propellers, and engines behind a delay, elsewhere.
        if not settling.is_balanced(fdm):
            settling.settle(fdm)
            if not settling.has_turboprop(fdm):
                self._stand(2.0)
        self._read()

    def _stand(self, seconds):
        """Run frames without motion: servos and filters reach the positions of the trim."""
        self.fdm.suspend_integration()
        for _ in range(round(seconds / self.model["dt_s"]) + 1):
            self.fdm.run()
        self.fdm.resume_integration()

    def _command(self):
        """Set commands, wind and parameters."""
        fdm = self.fdm
        for name, value in self.model["settings"].items():
            fdm[name] = value
        for row in self.model["commands"]:
            for name in row["properties"]:
                fdm[name] = self.values[row["name"]]
        for name, prop in WIND.items():
            fdm[prop] = self.values[name] / self.factors["ft"]
        for row in self.model["parameters"]:
            fdm[row["property"]] = self.values[row["name"]]

    def _read(self):
        """Read the outputs."""
        for name, (prop, unit, _) in OUTPUTS.items():
            self.values[name] = self.factors[unit] * self.fdm[prop]

    def do_step(self, current_time, step_size):
        """Fly frames of the aircraft's own step until the end of the communication step."""
        end = round((current_time + step_size) / self.model["dt_s"])
        self._command()
        while self.frames < end:
            if not self.fdm.run():
                return False
            self.frames += 1
        self.time = current_time + step_size
        self._read()
        return all(map(math.isfinite, (self.values[name] for name in OUTPUTS)))
