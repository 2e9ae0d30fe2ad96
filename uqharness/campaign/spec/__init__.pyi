from .campaign import CampaignSpec as CampaignSpec
from .read import campaign_from as campaign_from
from .read import read_campaign as read_campaign
from .read import with_samples as with_samples
from .samples import INTERIOR_MARK as INTERIOR_MARK
from .samples import NOMINAL as NOMINAL
