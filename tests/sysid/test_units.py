"""Units agree with their definitions, as far as their digits go."""

import math

import pytest

from sysid import units


def test_exact_units_follow_from_pound_foot_and_standard_gravity() -> None:
    assert pytest.approx(12 * units.IN_M, rel=1e-15) == units.FT_M
    assert pytest.approx(units.LB_KG * units.G0_MPS2, rel=1e-15) == units.LBF_N
    assert units.SLUG_FT2_KGM2 == units.LBF_N * units.FT_M
    assert math.pi * units.RAD_DEG == 180.0
    assert units.RAD_DEG * units.DEG_RAD == 1.0


@pytest.mark.parametrize(
    ("short", "exact", "rel"),
    [
        (units.SLUG_KG, units.LBF_N / units.FT_M, 1e-13),
        (units.PSF_PA, units.LBF_N / units.FT_M**2, 1e-14),
        (units.LBF_FT_NM, units.LBF_N * units.FT_M, 1e-15),
        (units.SLUG_FT3_KGPM3, units.LBF_N / units.FT_M**4, 1e-9),
    ],
)
def test_short_units_are_the_exact_ones_with_fewer_digits(
    short: float, exact: float, rel: float
) -> None:
    assert short != exact
    assert short == pytest.approx(exact, rel=rel)


def test_numbers_for_people_have_no_needless_exponent():
    from sysid.units import counted, percent, significant

    assert [significant(x) for x in (0.0, 104.0, 99.7, 0.0345, -1.26, 123456.0)] == [
        "0",
        "100",
        "100",
        "0.035",
        "-1.3",
        "120000",
    ]
    assert significant(1.2e-7) == "1.2e-07"
    assert significant(float("nan")) == "nan"
    assert percent(1.0) == "100 %"
    assert percent(0.0) == "0 %"
    assert (counted(1, "excursion"), counted(2, "excursion")) == ("1 excursion", "2 excursions")
