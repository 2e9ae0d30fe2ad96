"""What the verbs of ``uqharness campaign`` have in common on the command line."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uqharness.campaign.spec.campaign import CampaignSpec


def add_verb(verbs: Any, name: str, text: str, example: str) -> argparse.ArgumentParser:
    """A verb with its help, an example and ``--json``."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    return parser


def asked_campaign(args: argparse.Namespace) -> CampaignSpec:
    """The campaign of ``args.campaign`` with ``--hours`` and ``--samples`` in it. Raises BadInputError."""
    # Imported here: `uqharness --help` should not wait for the numerical libraries.
    from uqharness.campaign.spec.campaign import read_campaign
    from uqharness.project_files import find_campaign

    spec = read_campaign(find_campaign(args.campaign))
    if args.hours is not None:
        spec = spec.with_hours(args.hours)
    if args.samples is not None:
        spec = spec.with_samples(args.samples)
    return spec
