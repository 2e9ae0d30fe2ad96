"""Sensitivity studies against closed forms (linear, Ishigami, product, dead input), and their files: read as written or refused."""

from __future__ import annotations

import io
import json
import math
import re
import zipfile

import numpy as np
import pytest
from scipy import stats

from tests.helpers.few import few
from tests.helpers.places import ROOT
from uqharness import sensitivity
from uqharness.errors import BadInputError
from uqharness.sensitivity import study as problem
from uqharness.sensitivity.measures import pair_band
from uqharness.sensitivity.study import corners

A, B = 7.0, 0.1  # Ishigami's constants


PI = math.pi


def run(model, epistemic, aleatory=None, only=sensitivity.METHODS, **options):
    study = sensitivity.run_study(model, epistemic, aleatory, **options)
    return sensitivity.analyse(study, only)["output"]


def values(result):
    return {name: index.value for name, index in result.indices.items()}


def linear(a, b, c, m):
    return 2.0 * a + b + 0.0 * c + 0.1 * m


UNIT = {"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 1.0)}


NOISE = {"m": stats.norm(0.0, 1.0)}


@pytest.fixture(scope="module")
def of_linear():
    return run(linear, UNIT, NOISE)


def test_linear_corner_pairs_are_exact(of_linear):
    for name, share in {"a": 2 / 3, "b": 1 / 3, "c": 0.0}.items():
        index = of_linear["proposed"].indices[name]
        assert index.minimum.value == pytest.approx(share, abs=1e-12)
        assert index.maximum.value == pytest.approx(share, abs=1e-12)
        assert index.minimum.low - 1e-9 <= share <= index.maximum.high + 1e-9
    assert of_linear["proposed"].holds is True


def test_linear_variance_shares_are_squares_of_slopes(of_linear):
    for name, share in {"a": 0.8, "b": 0.2, "c": 0.0}.items():
        index = of_linear["anova"].indices[name]
        assert index.low - 1e-12 <= share <= index.high + 1e-12
        assert index.value == pytest.approx(share, abs=0.05)


def test_linear_local_and_scatter_are_slopes_over_the_sampled_width(of_linear):
    width = of_linear["local"].details["area"]
    assert 2.7 < width < 3.0  # E samples do not quite reach the corners, where it is 3
    assert values(of_linear["local"]) == pytest.approx(
        {"a": 2 / width, "b": 1 / width, "c": 0.0}, abs=1e-9
    )
    for name, share in {"a": 2 / width, "b": 1 / width, "c": 0.0}.items():
        index = of_linear["scatter"].indices[name]
        assert index.low <= share <= index.high
    assert of_linear["scatter"].indices["c"].low == 0.0
    assert of_linear["local"].holds is True


def test_linear_pinching_takes_what_the_slope_gives(of_linear):
    for name, share in {"a": 2 / 3, "b": 1 / 3, "c": 0.0}.items():
        index = of_linear["pbox"].indices[name]
        assert index.value == pytest.approx(share, abs=0.06)
        assert index.low - 1e-12 <= share <= index.high + 1e-12
    assert of_linear["pbox"].indices["c"].value == 0.0


def test_costs_are_those_of_table_4_1(of_linear):
    d, E, draws = 3, 1024, 100
    costs = {
        "local": d + 1,
        "scatter": E * draws,
        "anova": E * draws * (d + 2),
        "pbox": E * draws * (d + 1),
    }
    assert {method: result.runs for method, result in of_linear.items()} == costs | {
        "proposed": draws * 2**d
    }


def ishigami(x1, x2, x3):
    return np.sin(x1) + A * np.sin(x2) ** 2 + B * x3**4 * np.sin(x1)


@pytest.fixture(scope="module")
def of_ishigami():
    return run(ishigami, dict.fromkeys(("x1", "x2", "x3"), (-PI, PI)), samples=8192)


def test_ishigami_total_effects(of_ishigami):
    by_x1 = 0.5 * (1 + B * PI**4 / 5) ** 2
    by_x2 = A**2 / 8
    joint = B**2 * PI**8 * (1 / 18 - 1 / 50)
    variance = by_x1 + by_x2 + joint
    exact = {"x1": (by_x1 + joint) / variance, "x2": by_x2 / variance, "x3": joint / variance}
    assert values(of_ishigami["anova"]) == pytest.approx(exact, abs=0.03)
    assert of_ishigami["anova"].details["first_order"][2] == pytest.approx(0.0, abs=0.04)


def test_ishigami_local_sees_the_slope_at_the_centre_and_says_it_is_not_linear(of_ishigami):
    local = of_ishigami["local"]
    assert local.details["slope"] == pytest.approx([1.0, 0.0, 0.0], abs=0.5)
    assert local.indices["x3"].value == 0.0
    assert local.holds is False


def test_ishigami_scatter_says_its_lines_explain_little(of_ishigami):
    # Cov(x1, y) = (1 + B pi^4 / 5) E[x sin x] = that x 1, over Var x = pi^2 / 3
    slope = (1 + B * PI**4 / 5) * 3 / PI**2
    assert of_ishigami["scatter"].details["slope"][0] == pytest.approx(slope, abs=0.08)
    assert of_ishigami["scatter"].details["r2_sum"] < 0.3
    assert of_ishigami["scatter"].holds is False
    assert "far from 1" in of_ishigami["scatter"].statement


def test_ishigami_pinching(of_ishigami):
    # Range: sin x1 (1 + B x3^4) + 7 sin^2 x2 lies in [-(1+B pi^4), 1+B pi^4+7]; x1 = 0 leaves 7, x2
    # = 0 takes 7, x3 = 0 leaves 9.
    complete = 2 * (1 + B * PI**4) + A
    exact = {"x1": 1 - A / complete, "x2": A / complete, "x3": 1 - 9 / complete}
    assert values(of_ishigami["pbox"]) == pytest.approx(exact, abs=0.05)


def test_ishigami_corners_are_all_equal_so_their_shares_are_undefined_with_a_reason(of_ishigami):
    for index in of_ishigami["proposed"].indices.values():
        assert math.isnan(index.minimum.value)
        assert math.isnan(index.maximum.high)
        assert "not monotone" in index.reason


def test_product_pairs_depend_on_the_other_factor():
    result = run(lambda a, b: a * b, {"a": (1.0, 3.0), "b": (2.0, 3.0)})
    # Corners 2, 3, 6, 9: widths of a at b = 2, 3: 4, 6; of b at a = 1, 3: 1, 3; envelope 7.
    a, b = (result["proposed"].indices[name] for name in "ab")
    assert sorted(a.pairs) == pytest.approx([4 / 7, 6 / 7])
    assert (b.minimum.value, b.maximum.value) == pytest.approx((1 / 7, 3 / 7))
    # Fixed at its bounds: a leaves 1 or 3 of 7, b leaves 4 or 6.
    assert result["proposed"].details["shrink_min"] == pytest.approx([4 / 7, 1 / 7])
    assert result["proposed"].details["shrink_max"] == pytest.approx([6 / 7, 3 / 7])
    # Var ab = Va Vb + Va mb^2 + Vb ma^2 with Va = 1/3, Vb = 1/12, ma = 2, mb = 2.5
    va, vb = 1 / 3, 1 / 12
    variance = va * vb + va * 2.5**2 + vb * 4
    exact = {"a": (va * 2.5**2 + va * vb) / variance, "b": (vb * 4 + va * vb) / variance}
    assert values(result["anova"]) == pytest.approx(exact, abs=0.05)
    assert result["anova"].details["total_sum"] > 1.0
    area = result["local"].details["area"]
    assert values(result["local"]) == pytest.approx({"a": 2 * 2.5 / area, "b": 2.0 / area})
    assert values(result["scatter"]) == pytest.approx(
        {"a": 2 * 2.5 / area, "b": 2.0 / area}, abs=0.05
    )
    assert result["pbox"].indices["a"].value == pytest.approx(1 - 2 / 7, abs=0.07)


def test_a_monotone_curve_satisfies_the_corners_and_a_bump_does_not():
    monotone = run(lambda a, b: np.exp(a) + 0.1 * b, {"a": (0.0, 2.0), "b": (0.0, 1.0)})["proposed"]
    assert monotone.holds is True
    assert monotone.details["interior_outside"] == 0.0
    bump = run(lambda a, b: a * (1.0 - a) + 0.1 * b, {"a": (0.0, 1.0), "b": (0.0, 1.0)})["proposed"]
    assert bump.holds is False
    # The corners see 0.1 of b alone; inside, a adds up to 0.25.
    assert bump.indices["a"].maximum.value == 0.0
    assert bump.details["interior_outside"] == pytest.approx(2.5, abs=0.1)
    assert "too small" in bump.statement


def test_a_model_without_any_effect_is_undefined_in_all_five():
    outcome = run(
        lambda a, b, m: 0.0 * a + m, {"a": (0.0, 1.0), "b": (0.0, 1.0)}, {"m": stats.norm(3.0, 0.2)}
    )
    for result in outcome.values():
        for index in result.indices.values():
            assert index.reason
            assert index.as_dict()["value"] in (None, [None, None])
    constant = run(lambda a: 7.0, {"a": (0.0, 1.0)})
    assert all(index.reason for result in constant.values() for index in result.indices.values())


def test_outputs_that_are_not_finite_make_the_index_undefined_and_are_counted():
    def fails_high(a, b):
        return np.where(a > 0.95, np.nan, a + b)

    result = run(fails_high, {"a": (0.0, 1.0), "b": (0.0, 1.0)})
    assert "4 of 4" not in result["proposed"].statement
    assert "2 of 4 corners runs gave no finite value" in result["proposed"].statement
    assert all(math.isnan(index.value) for index in result["anova"].indices.values())


def test_anova_agrees_with_scipys_own_estimator():
    study = sensitivity.run_study(
        ishigami, dict.fromkeys(("x1", "x2", "x3"), (-PI, PI)), samples=1024
    )
    runs = study.outputs["output"]
    f_A, f_B, f_AB = runs.sampled[:, 0], runs.second[:, 0], runs.mixed[:, :, 0]
    by_hand = [np.mean((f_A - f) ** 2) / 2.0 / np.var(np.concatenate([f_A, f_B])) for f in f_AB]
    result = sensitivity.analyse(study, ("anova",))["output"]["anova"]
    assert list(values(result).values()) == pytest.approx(by_hand)


def test_a_models_named_outputs_and_scalar_models():
    def scalar(a, m):
        return {"double": 2.0 * a if a > 0 else 0.0, "sum": math.fsum([a, m])}

    study = sensitivity.run_study(
        scalar, {"a": (0.0, 1.0)}, NOISE, samples=32, draws=8, vectorised=False
    )
    result = sensitivity.analyse(study)
    assert set(result.results) == {"double", "sum"}
    assert result["double"]["proposed"].indices["a"].maximum.value == pytest.approx(1.0)
    assert "double" in result.text()
    with pytest.raises(BadInputError, match="different outputs"):
        sensitivity.run_study(
            lambda a: {"x": a} if a < 0.5 else {"z": a}, {"a": (0, 1)}, samples=32, vectorised=False
        )
    with pytest.raises(BadInputError, match="vectorised=False"):
        sensitivity.run_study(lambda a: np.array([1.0, 2.0]), {"a": (0.0, 1.0)}, samples=32)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (({},), "epistemic is empty"),
        (({"a": (1.0, 1.0)},), "lower < upper"),
        (({"a": 3.0},), "must be a pair"),
        (({"a": (0.0, math.inf)},), "finite"),
        (({"a": (0.0, 1.0)}, {"a": stats.norm()}), "both epistemic and aleatory"),
        (({"a": (0.0, 1.0)}, {"m": 3.0}), "no ppf"),
    ],
)
def test_bad_definitions_are_named(arguments, words):
    with pytest.raises(BadInputError, match=words):
        sensitivity.run_study(lambda **values: 0.0, *arguments)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"samples": 1000}, "power of two; use 512 or 1024"),
        ({"samples": 2}, "at least 16"),
        ({"methods": ("sobol",)}, "choose among local"),
        ({"nominal": {"a": 2.0}}, "outside its interval"),
        ({"nominal": {"z": 2.0}}, "not among"),
        ({"step": {"a": 0.0}}, "needs a step"),
    ],
)
def test_bad_options_are_named(options, words):
    with pytest.raises(BadInputError, match=words):
        sensitivity.run_study(lambda a: a, {"a": (0.0, 1.0)}, **options)


def test_too_many_corners_are_refused_with_the_way_out():
    many = {f"k{i}": (0.0, 1.0) for i in range(20)}
    with pytest.raises(BadInputError, match="leave 'proposed' out"):
        sensitivity.run_study(lambda **k: k["k0"], many)


REPEATS = 40


def test_scatter_intervals_cover_the_mean_over_repeats():
    study = [
        run(linear, UNIT, NOISE, ("scatter",), samples=128, draws=8, seed=seed)["scatter"]
        for seed in range(REPEATS)
    ]
    for name in "ab":
        mean = np.mean([result.indices[name].value for result in study])
        inside = np.mean(
            [result.indices[name].low <= mean <= result.indices[name].high for result in study]
        )
        assert inside >= 0.88
        # An interval that covers because it says nothing would pass too.
        assert (
            np.mean([result.indices[name].high - result.indices[name].low for result in study])
            < 0.5 * mean + 0.3
        )


def test_pinching_intervals_cover_the_mean_over_repeats():
    study = [
        run(lambda a, b, c: a * b + 0.5 * c, UNIT, only=("pbox",), samples=128, seed=s)["pbox"]
        for s in range(REPEATS)
    ]
    for name in "abc":
        mean = np.mean([result.indices[name].value for result in study])
        inside = np.mean(
            [result.indices[name].low <= mean <= result.indices[name].high for result in study]
        )
        assert inside >= 0.9


def corner_flights(draws, rng, specific):
    """Eight corners with a share that interacts, a weak one, a shared spread, and noise of each
    corner's own.
    """
    a, b, c = corners(np.zeros(3), np.ones(3)).T
    base = a + 0.6 * b + 0.3 * a * b + 0.02 * c
    return (
        base[:, None]
        + rng.gamma(2.0, 0.3, draws) * (1 + 0.3 * b[:, None])
        + specific * rng.normal(size=(8, draws))
    )


@pytest.mark.parametrize(("specific", "draws"), few([(0.0, 8), (0.1, 8), (0.4, 32)], 1))
def test_pair_intervals_cover_both_ends_from_few_draws(specific, draws):
    truth = pair_band(
        corner_flights(100_000, np.random.default_rng(1), specific), 3, seed=0, resamples=0
    ).index[:, :-2]
    ends = truth.min(axis=1), truth.max(axis=1)
    inside = 0
    for seed in range(REPEATS):
        band = pair_band(
            corner_flights(draws, np.random.default_rng(100 + seed), specific), 3, seed=seed
        )
        low, high = band.low[:, :-2], band.high[:, :-2]
        inside += np.all(
            (low.min(axis=1) <= ends[0] + 1e-6) & (ends[0] <= high.min(axis=1) + 1e-6)
        ) and np.all((low.max(axis=1) <= ends[1] + 1e-6) & (ends[1] <= high.max(axis=1) + 1e-6))
    assert inside / REPEATS >= 0.85  # of all six ends at once; nominal 0.95, 40 repeats


@pytest.mark.parametrize("ratio", [1.0, 0.6])
def test_a_lead_is_claimed_where_there_is_one_and_not_in_a_tie(ratio):
    claimed = 0
    for seed in range(REPEATS):
        rng = np.random.default_rng(300 + seed)
        a, b, c = corners(np.zeros(3), np.ones(3)).T
        y = (
            (a + ratio * b + 0.2 * c)[:, None]
            + rng.gamma(2.0, 0.3, 8)
            + 0.1 * rng.normal(size=(8, 8))
        )
        lead = pair_band(y, 3, seed=seed).lead
        claimed += bool(np.any([np.all(np.delete(lead[i], i) > 0.0) for i in range(3)]))
    assert claimed / REPEATS <= 0.1 if ratio == 1.0 else claimed / REPEATS >= 0.8


def test_pair_intervals_need_draws_and_say_so():
    def noisy(a, m):
        return a * (1.0 + m)

    few = run(noisy, {"a": (0.0, 1.0)}, NOISE, draws=5, samples=16)["proposed"]
    assert math.isnan(few.indices["a"].minimum.low)
    assert "no interval from 5 aleatory draws: at least 8" in few.indices["a"].reason
    with pytest.raises(BadInputError, match="at least 2 draws"):
        run(noisy, {"a": (0.0, 1.0)}, NOISE, draws=1, samples=16)
    none = run(lambda a: a, {"a": (0.0, 1.0)}, samples=16)["proposed"]
    assert (none.indices["a"].minimum.low, none.indices["a"].maximum.high) == (1.0, 1.0)


def test_the_example_in_the_documentation_runs_and_is_right(capsys):
    page = (ROOT / "docs" / "sensitivity.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names: dict[str, object] = {}
    exec(code, names)
    text = capsys.readouterr().out
    assert "proposed: 400 runs" in text
    low, high, floor, top = map(float, text.splitlines()[-1].split())
    # V (CD0 + k CL^2) / CL at mean mass and area: CD0 moves it by 0.01 V / CL, k by 0.01 V CL; both
    # ranges are exact and additive.
    CL = 21.5 * 9.81 / (245.0 * 1.97)
    share = (0.01 / CL) / (0.01 / CL + 0.01 * CL)
    assert low == pytest.approx(share, abs=0.005)
    assert high == pytest.approx(share, abs=0.005)
    assert floor <= low <= high <= top


UNIT_ARRAY_ARCHIVE = {"a": (0.0, 1.0), "b": (0.0, 1.0)}


@pytest.fixture
def study(tmp_path):
    """Arrays of a sound study's file by member."""
    result = sensitivity.run_study(
        lambda a, b, w: a + b * w,
        UNIT_ARRAY_ARCHIVE,
        {"w": stats.norm(0.0, 1.0)},
        samples=16,
        draws=8,
    )
    sensitivity.write_study(result, tmp_path / "sound.npz")
    with zipfile.ZipFile(tmp_path / "sound.npz") as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(members, path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def array(values):
    out = io.BytesIO()
    np.save(out, values, allow_pickle=True)
    return out.getvalue()


def promise(shape, descr="<f8"):
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        out, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return out.getvalue() + bytes(64)


class Runs:
    def __reduce__(self):
        return print, ("unpickled",)


def header(**changes):
    text = json.dumps({"names": ["a", "b"], "outputs": ["output"], "chance": True} | changes)
    return array(np.frombuffer(text.encode(), np.uint8))


HOSTILE = {
    "a promise": {"theta.npy": promise((10**12,))},
    "an object": {"theta.npy": array(np.array([Runs()], dtype=object))},
    "text": {"theta.npy": array(np.array(["x"]))},
    "other shape": {"lower.npy": array(np.zeros(3))},
    "other draws": {"0/corners.npy": array(np.zeros((4, 7)))},
    "other corners": {"0/corners.npy": array(np.zeros((5, 8)))},
    "whole numbers": {"upper.npy": array(np.ones(2, dtype=int))},
    "names that are none": {"header.npy": header(names=[{}, []])},
    "no outputs": {"header.npy": header(outputs=None)},
    "no JSON": {"header.npy": array(np.zeros(3, np.uint8))},
    "no array": {"theta.npy": b"\x93NUMPY\x01\x00\xff\xff{"},
    "odd header": {"theta.npy": b"\x93NUMPY\x01\x00\x08\x00{'descr'"},
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused(name, study, tmp_path, capsys):
    path = packed(study | HOSTILE[name], tmp_path / "study.npz")
    with pytest.raises(BadInputError, match=r"study\.npz: not a study") as refused:
        sensitivity.read_study(path)
    assert "\n" not in str(refused.value)
    assert "unpickled" not in capsys.readouterr().out


def test_a_damaged_archive_is_refused_or_gives_the_same_arrays(study, tmp_path):
    content = packed(study, tmp_path / "study.npz").read_bytes()
    sound = problem.read_arrays(tmp_path / "study.npz")
    refused = 0
    for place in range(40, len(content), 31):
        damaged = bytearray(content)
        damaged[place] ^= 0x41
        (tmp_path / "damaged.npz").write_bytes(damaged)
        try:
            result = problem.read_arrays(tmp_path / "damaged.npz")
        except BadInputError:
            refused += 1
            continue
        # A name may be the damaged part; what an array holds may not.
        assert sorted(v.tobytes() for v in result.values()) == sorted(
            v.tobytes() for v in sound.values()
        )
    assert refused > 50


def test_a_bomb_is_refused_before_it_is_unpacked(study, tmp_path, monkeypatch):
    path = packed(study, tmp_path / "study.npz")
    monkeypatch.setattr(problem, "MAX_BYTES", 100)
    with pytest.raises(BadInputError, match="would take"):
        sensitivity.read_study(path)
