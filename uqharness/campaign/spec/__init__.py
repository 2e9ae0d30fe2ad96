"""campaign.toml: its sections, checked."""
