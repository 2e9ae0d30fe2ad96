"""What a notebook shows of a campaign: statements and a chart that is an image of its own."""

from __future__ import annotations

import base64
import re

import pytest
from lxml import etree

import uqharness as uq
from uqharness.commands.campaign import CampaignResult

pytestmark = pytest.mark.usefixtures("flights_here")

CAMPAIGN = {
    "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1, "engine": "jsbsim"},
    "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0, "wind_mps": [0, 3]},
    "epistemic": {
        "method": "corners",
        "coefficients": ["CX"],
        "bounds": {"CX": 0.008},
        "interior": 0,
        "nominal": False,
    },
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> CampaignResult:
    return uq.run_campaign(CAMPAIGN, tmp_path_factory.mktemp("campaign") / "results", workers=1)


def test_a_campaign_shows_its_size_statements_and_p_boxes(flown: CampaignResult):
    shown = flown._repr_html_()
    assert "aircraft: espaaro; flights: 8; failed or aborted: 0" in shown
    assert "<th>worst_per_h</th>" in shown
    (content,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', shown)
    drawing = etree.fromstring(base64.b64decode(content))
    words = "".join(drawing.itertext())
    assert "0 m/s" in words
    assert "3 m/s" in words
    # A style sheet outside the image would change the rest of the notebook.
    assert "<style" not in shown
