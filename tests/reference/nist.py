"""NIST Statistical Reference Datasets (https://www.itl.nist.gov/div898/strd): data and certified
values, in nist.json.
"""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np

MISRA1A, THURBER, LONGLEY, FILIP = (
    SimpleNamespace(**{key: np.array(item) for key, item in sets.items()})
    for sets in json.loads(Path(__file__).with_name("nist.json").read_text()).values()
)
