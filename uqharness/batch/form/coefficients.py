"""Constants of ``form.maths``, printed by fits against mpmath: do not edit."""

from __future__ import annotations

SIN = (
    float.fromhex("-0x1.5555555555555p-3"),
    float.fromhex("0x1.1111111111110p-7"),
    float.fromhex("-0x1.a01a01a019937p-13"),
    float.fromhex("0x1.71de3a54607a5p-19"),
    float.fromhex("-0x1.ae64541295cdfp-26"),
    float.fromhex("0x1.61217ee5cca1bp-33"),
    float.fromhex("-0x1.ab17bdcbd3414p-41"),
)
"""(sin r - r) / r^3 in r^2; error relative to the result 2^-57.3."""

COS = (
    float.fromhex("0x1.5555555555555p-5"),
    float.fromhex("-0x1.6c16c16c16c16p-10"),
    float.fromhex("0x1.a01a01a019d0ap-16"),
    float.fromhex("-0x1.27e4fb7712ca2p-22"),
    float.fromhex("0x1.1eed8deb82809p-29"),
    float.fromhex("-0x1.9394b9eb4d56dp-37"),
    float.fromhex("0x1.ab78473be59d7p-45"),
)
"""(cos r - 1 + r^2/2) / r^4 in r^2; error relative to the result 2^-60.0."""

EXP = (
    float.fromhex("0x1.0000000000000p-1"),
    float.fromhex("0x1.5555555555557p-3"),
    float.fromhex("0x1.5555555555556p-5"),
    float.fromhex("0x1.11111111100dcp-7"),
    float.fromhex("0x1.6c16c16c162d4p-10"),
    float.fromhex("0x1.a01a01abe7fe1p-13"),
    float.fromhex("0x1.a01a01a6d889cp-16"),
    float.fromhex("0x1.71de0231960ebp-19"),
    float.fromhex("0x1.27e4db646b17ep-22"),
    float.fromhex("0x1.af4de97ca4194p-26"),
    float.fromhex("0x1.1f730349868cdp-29"),
)
"""(exp r - 1 - r) / r^2 in r; error relative to the result 2^-61.6."""

LOG = (
    float.fromhex("0x1.5555555555555p-1"),
    float.fromhex("0x1.9999999999a38p-2"),
    float.fromhex("0x1.2492492476c87p-2"),
    float.fromhex("0x1.c71c720160b47p-3"),
    float.fromhex("0x1.745cf901605f7p-3"),
    float.fromhex("0x1.3b1c360763b8ap-3"),
    float.fromhex("0x1.0fbe83c2cbcf3p-3"),
    float.fromhex("0x1.0c04595972ab8p-3"),
)
"""(log((1+s)/(1-s)) / s - 2) / s^2 in s^2; error relative to the result 2^-59.7."""

LOG_TAIL = (
    float.fromhex("0x1.999999999999ap-2"),
    float.fromhex("0x1.2492492492491p-2"),
    float.fromhex("0x1.c71c71c71cfd9p-3"),
    float.fromhex("0x1.745d174513593p-3"),
    float.fromhex("0x1.3b13b1bc75cd4p-3"),
    float.fromhex("0x1.1110dfad0f8eap-3"),
    float.fromhex("0x1.e1f7fa7547177p-4"),
    float.fromhex("0x1.ac4a89c964b82p-4"),
    float.fromhex("0x1.b8d433113b7fap-4"),
)
"""the same without its term 2/3, over s^4; error relative to the result 2^-65.5."""

ATAN = (
    float.fromhex("-0x1.5555555555555p-2"),
    float.fromhex("0x1.99999999998e1p-3"),
    float.fromhex("-0x1.249249248826ep-3"),
    float.fromhex("0x1.c71c71c019943p-4"),
    float.fromhex("-0x1.745d16022ef7cp-4"),
    float.fromhex("0x1.3b138e5d6e4d4p-4"),
    float.fromhex("-0x1.110ea4a6d11d8p-4"),
    float.fromhex("0x1.e1a7ab329d514p-5"),
    float.fromhex("-0x1.ad44aa95f9806p-5"),
    float.fromhex("0x1.7b1fe79f9966bp-5"),
    float.fromhex("-0x1.37d510b4c7113p-5"),
    float.fromhex("0x1.99adbb7f8ae7dp-6"),
    float.fromhex("-0x1.2df1bf8fe9167p-7"),
)
"""(atan r - r) / r^3 in r^2, r up to 1/2; error relative to the result 2^-57.7."""

ASIN = (
    float.fromhex("0x1.5555555555556p-3"),
    float.fromhex("0x1.3333333332ecap-4"),
    float.fromhex("0x1.6db6db6e31f13p-5"),
    float.fromhex("0x1.f1c71c1db0623p-6"),
    float.fromhex("0x1.6e8bb1c8209a2p-6"),
    float.fromhex("0x1.1c4d35cf95421p-6"),
    float.fromhex("0x1.c9cf07674736ap-7"),
    float.fromhex("0x1.782651caa6547p-7"),
    float.fromhex("0x1.52420b04b37bep-7"),
    float.fromhex("0x1.65a9c4dfcf8b2p-8"),
    float.fromhex("0x1.1d189408314eep-6"),
    float.fromhex("-0x1.e6aaa8a0a04ccp-7"),
    float.fromhex("0x1.d72b2bc8155f8p-6"),
)
"""(asin u - u) / u^3 in u^2; error relative to the result 2^-57.4."""

HALF_PI_PARTS = (
    float.fromhex("0x1.921fb54400000p+0"),
    float.fromhex("0x1.0b4611a600000p-34"),
    float.fromhex("0x1.3198a2e000000p-69"),
    float.fromhex("0x1.b839a252049c1p-104"),
)
"""pi/2 in parts of 33, 33, 33 and 53 bits."""

PI_PARTS = (
    float.fromhex("0x1.921fb54442d18p+1"),
    float.fromhex("0x1.1a62633145c07p-53"),
)
"""pi in two doubles."""

LN2_PARTS = (
    float.fromhex("0x1.62e42fee00000p-1"),
    float.fromhex("0x1.a39ef35793c76p-33"),
)
"""ln 2: 32 bits and the rest."""

LN2_THREE = (
    float.fromhex("0x1.62e42fefa2000p-1"),
    float.fromhex("0x1.9ef35793c6000p-41"),
    float.fromhex("0x1.673007e5ed5e8p-81"),
)
"""ln 2: 40 bits, 40 bits and the rest."""

LOG2_E_PARTS = (
    float.fromhex("0x1.7154760000000p+0"),
    float.fromhex("0x1.4ae0bf85ddf43p-26"),
    float.fromhex("0x1.fed0691d3e88fp-79"),
)
"""1/ln 2: 26 bits, 53 bits, the rest."""

LOG10_E_PARTS = (
    float.fromhex("0x1.bcb7b10000000p-2"),
    float.fromhex("0x1.49b9438ca9aadp-28"),
    float.fromhex("0x1.aaafad33dc324p-81"),
)
"""1/ln 10: 26 bits, 53 bits, the rest."""

LOG10_2_PARTS = (
    float.fromhex("0x1.34413509f6000p-2"),
    float.fromhex("0x1.9fef311f12b36p-42"),
)
"""log10 of 2: 40 bits and the rest."""

TWO_THIRDS = (
    float.fromhex("0x1.5555555555555p-1"),
    float.fromhex("0x1.5555555555555p-55"),
)
"""2/3 in two doubles."""
