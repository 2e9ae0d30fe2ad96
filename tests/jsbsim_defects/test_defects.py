"""Behaviours of JSBSim 1.3.3 that bite, each reproduced by the smallest model: docs/jsbsim-traps.md
tells what to do about them.

A test that fails here after an upgrade means that JSBSim changed, not that this project broke.
"""

from __future__ import annotations

import jsbsim
import numpy as np
import pytest

from tests.jsbsim_defects.small_models import dies, load, small, write_model

LOADING = """
fdm = jsbsim.FGFDMExec(root); fdm.set_debug_level(0)
try:
    fdm.load_model("small"); fdm.run_ic()
except Exception:
    pass
"""


def channel(components: str, attributes: str = "") -> str:
    return (
        '<property value="0">test/in</property><channel name="c"'
        f" {attributes}>{components}</channel>"
    )


def step_response(fdm, name: str, steps: int) -> list[float]:
    fdm.run_ic()
    fdm["test/in"] = 1.0
    values = []
    for _ in range(steps):
        fdm.run()
        values.append(fdm[name])
    return values


def test_a_missing_property_aborts_when_the_model_is_destroyed(tmp_path):
    missing = "<function name='aero/x'><property>no/such</property></function>"
    write_model(tmp_path, aero=missing)
    assert dies(LOADING + "del fdm\n", tmp_path) == -6
    # The cure: make the property before the object dies.
    assert dies(LOADING + "fdm['no/such'] = 0.0\ndel fdm\n", tmp_path) == 0


def test_an_unknown_function_operation_is_a_segmentation_fault(tmp_path):
    write_model(
        tmp_path,
        aero="<function name='aero/x'><prodct><value>1</value><value>2</value></prodct></function>",
    )
    assert dies(LOADING, tmp_path) < 0


def test_an_illegal_property_name_raises_outside_jsbsims_own_errors(tmp_path):
    root = write_model(tmp_path, fcs="<property value='0'>aero/Cm_p^2</property>")
    fdm = jsbsim.FGFDMExec(str(root))
    with pytest.raises(RuntimeError, match="name may contain only") as caught:
        fdm.load_model("small")
    # So a caller who catches jsbsim.BaseError misses it.
    assert not isinstance(caught.value, jsbsim.BaseError)


def test_a_second_load_on_one_instance_ends_the_interpreter(tmp_path):
    write_model(
        tmp_path,
        fcs=channel("<pure_gain name='g'><input>test/in</input><gain>2</gain></pure_gain>"),
    )
    repeat = (
        LOADING + "node = fdm.get_property_manager().get_node('fcs/g')\nfdm.load_model('small')\n"
    )
    assert (
        dies(
            repeat
            + "fdm.run_ic()\n[fdm.run() for _ in range(50)]\nnode.get_double_value()\ndel fdm\n",
            tmp_path,
        )
        != 0
    )


def test_misspelt_reads_and_writes(tmp_path):
    fdm = small(tmp_path)
    with pytest.raises(KeyError):
        fdm["no/such"]
    assert fdm.get_property_value("no/such") == 0.0
    fdm["no/such"] = 3.0
    assert fdm["no/such"] == 3.0


def test_setting_a_read_only_property_is_ignored_in_silence(tmp_path):
    fdm = small(tmp_path)
    fdm.run_ic()
    before = fdm["aero/qbar-psf"]
    fdm["aero/qbar-psf"] = 999.0
    assert fdm["aero/qbar-psf"] == before


def test_not_a_number_runs_on(tmp_path):
    invalid = "<property value='0'>test/in</property>"
    root = (
        "<axis name='PITCH'><function"
        " name='aero/m'><sqrt><property>test/in</property></sqrt></function></axis>"
    )
    fdm = small(tmp_path, fcs=invalid, aero=root)
    fdm.run_ic()
    fdm["test/in"] = -1.0
    assert all(fdm.run() for _ in range(5))
    assert np.isnan(fdm["velocities/q-rad_sec"])


def test_the_ground_stops_nobody(tmp_path):
    fdm = small(tmp_path)
    fdm["ic/h-sl-ft"] = 3.0
    fdm.run_ic()
    assert all(fdm.run() for _ in range(300))
    assert fdm["position/h-agl-ft"] < 0.0


def test_ixz_is_read_with_its_sign_reversed(tmp_path):
    plain = small(tmp_path / "a", ixz='<ixz unit="KG*M2">0.25</ixz>')
    output = small(
        tmp_path / "b",
        ixz='<ixz unit="KG*M2">0.25</ixz>',
        mass_attributes='negated_crossproduct_inertia="false"',
    )
    for fdm in (plain, output):
        fdm.run_ic()
    assert plain["inertia/ixz-slugs_ft2"] == pytest.approx(-output["inertia/ixz-slugs_ft2"])
    assert plain["inertia/ixz-slugs_ft2"] != 0.0


def test_a_force_acts_at_aerorp_unless_told_otherwise(tmp_path):
    def pitching(name: str, extra: str) -> float:
        force = (
            f"<axis name='Z'><function name='aero/z' {extra}><value>-10</value></function></axis>"
        )
        fdm = small(tmp_path / name, aero=force, aerorp=0.3)
        fdm.run_ic()
        return fdm["moments/m-aero-lbsft"]

    assert abs(pitching("rp", "")) == pytest.approx(10 * 0.3 / 0.3048, rel=1e-6)
    assert pitching("cg", "apply_at_cg='true'") == 0.0


def test_mixed_axis_systems_corrupt_the_forces_without_a_word(tmp_path):
    body = "<axis name='Z'><function name='aero/z'><value>-47</value></function></axis>"
    lift = "<axis name='LIFT'><function name='aero/l'><value>0</value></function></axis>"
    sound, mixed = small(tmp_path / "a", aero=body), small(tmp_path / "b", aero=body + lift)
    for fdm in (sound, mixed):
        fdm.run_ic()
    assert sound["forces/fbz-aero-lbs"] == pytest.approx(-47.0)
    # A lift of nothing was added.
    assert mixed["forces/fbz-aero-lbs"] != pytest.approx(-47.0)


DELAYED = {
    "sensor": "<sensor name='g'><input>test/in</input><delay type='frames'>{}</delay></sensor>",
    "actuator": (
        "<actuator name='g'><input>test/in</input><delay type='frames'>{}</delay></actuator>"
    ),
    "pure_gain": (
        "<pure_gain name='g'><input>test/in</input><gain>1</gain><delay"
        " type='frames'>{}</delay></pure_gain>"
    ),
    "summer": "<summer name='g'><input>test/in</input><delay type='frames'>{}</delay></summer>",
}


@pytest.mark.parametrize(
    ("component", "latencies"),
    [
        ("sensor", [0, 1, 2]),
        ("actuator", [0, 1, 2]),
        ("pure_gain", [0, 0, 0]),
        ("summer", [0, 0, 0]),
    ],
)
def test_a_delay_of_n_frames_is_n_minus_one_and_only_sensors_and_actuators_have_it(
    tmp_path, component, latencies
):
    def latency(frames: int) -> int:
        parts = channel(DELAYED[component].format(frames))
        return step_response(small(tmp_path / str(frames), fcs=parts), "fcs/g", 8).index(1.0)

    assert [latency(n) for n in (1, 2, 3)] == latencies


def test_percent_noise_is_a_fraction(tmp_path):
    parts = (
        "<sensor name='s'><input>test/in</input><noise variation='PERCENT'"
        " distribution='GAUSSIAN'>0.5</noise></sensor>"
    )
    fdm = small(tmp_path, fcs=channel(parts))
    fdm.run_ic()
    fdm["test/in"] = 10.0
    values = [fdm.run() and fdm["fcs/s"] for _ in range(4000)]
    assert np.std(values) == pytest.approx(5.0, rel=0.1)


def test_a_gain_of_zero_in_a_sensor_is_no_gain(tmp_path):
    fdm = small(
        tmp_path, fcs=channel("<sensor name='s'><input>test/in</input><gain>0</gain></sensor>")
    )
    assert step_response(fdm, "fcs/s", 2)[-1] == 1.0


def test_a_step_set_after_loading_leaves_the_filters_wrong(tmp_path):
    root = write_model(
        tmp_path, fcs=channel("<lag_filter name='f'><input>test/in</input><c1>10</c1></lag_filter>")
    )
    right = load(root, dt=0.02)
    late = load(root, dt=0.01)
    late.set_dt(0.02)
    expected = 1.0 - np.exp(-10 * 0.02 * 4.5)
    assert step_response(right, "fcs/f", 5)[-1] == pytest.approx(expected, abs=0.01)
    assert step_response(late, "fcs/f", 5)[-1] < expected - 0.15


def test_reset_is_not_a_fresh_instance(tmp_path):
    fdm = small(
        tmp_path,
        fcs=channel("<sensor name='s'><input>test/in</input><drift_rate>1.0</drift_rate></sensor>"),
    )
    fresh = step_response(fdm, "fcs/s", 100)[-1]
    fdm["test/in"] = 0.0
    fdm.reset_to_initial_conditions(0)
    # The drift of the first flight goes on in the second.
    assert step_response(fdm, "fcs/s", 100)[-1] > fresh + 0.9


def test_wind_set_before_initialising_is_overwritten(tmp_path):
    fdm = small(tmp_path)
    fdm["atmosphere/wind-east-fps"] = 20.0
    fdm.run_ic()
    assert fdm["atmosphere/wind-east-fps"] == 0.0


def test_the_wind_direction_of_the_initial_conditions_is_where_it_blows_to(tmp_path):
    fdm = small(tmp_path)
    fdm["ic/vw-mag-fps"], fdm["ic/vw-dir-deg"] = 20.0, 270.0
    fdm.run_ic()
    assert fdm["atmosphere/wind-east-fps"] == pytest.approx(-20.0)


def test_unseeded_runs_are_all_the_same_and_seed_zero_is_seed_one(tmp_path):
    noise = "<fcs_function name='fcs/n'><function><random/></function></fcs_function>"
    root = write_model(tmp_path, fcs=channel(noise))

    def draws(seed: int | None) -> list[float]:
        fdm = load(root)
        if seed is not None:
            fdm["simulation/randomseed"] = seed
        fdm.run_ic()
        return [fdm.run() and fdm["fcs/n"] for _ in range(20)]

    assert draws(None) == draws(None)
    assert draws(0) == draws(1)
    assert draws(1) != draws(2)


def test_the_version_these_findings_belong_to():
    assert jsbsim.__version__ == "1.3.3"


def test_a_second_element_for_an_axis_replaces_the_first(tmp_path):
    one = "<axis name='X'><function name='a/x'><value>-30</value></function></axis>"
    other = "<axis name='{}'><function name='b/x'><value>-7</value></function></axis>"
    for name, total in (("X", -7.0), ("Y", -30.0)):
        fdm = small(tmp_path, aero=one + other.format(name))
        fdm.run_ic()
        assert fdm["forces/fbx-aero-lbs"] == total


def test_a_reset_loses_the_shift_of_the_aerodynamic_reference_point(tmp_path):
    shift = "<aero_ref_pt_shift_x><function><value>0.5</value></function></aero_ref_pt_shift_x>"
    fdm = small(
        tmp_path,
        aero=shift + "<axis name='Z'><function name='a/z'><value>-40</value></function></axis>",
    )
    fdm.run_ic()
    moment = fdm["moments/m-aero-lbsft"]
    assert abs(moment) == pytest.approx(40 * 0.5 * 0.5 / 0.3048, rel=1e-6)
    fdm.reset_to_initial_conditions(0)
    assert fdm["moments/m-aero-lbsft"] == pytest.approx(0.0, abs=1e-9)


def test_the_file_of_a_models_own_output_is_made_though_output_is_disabled(tmp_path):
    write_model(tmp_path)
    xml = tmp_path / "aircraft" / "small" / "small.xml"
    text = xml.read_text().replace(
        "</fdm_config>",
        "<output name='log.csv' type='CSV' rate='10'><rates>ON</rates></output></fdm_config>",
    )
    xml.write_text(text)
    fdm = load(tmp_path)
    fdm.disable_output()
    fdm.run_ic()
    assert (tmp_path / "log.csv").is_file()


def test_the_larger_of_nan_and_a_number_is_the_number(tmp_path):
    nan = "<property value='0'>test/nan</property>"
    greater = (
        "<function"
        " name='test/max'><max><property>test/nan</property><value>0</value></max></function>"
    )
    fdm = small(tmp_path, aero=nan + greater)
    fdm["test/nan"] = float("nan")
    fdm.run_ic()
    assert fdm["test/max"] == 0.0
