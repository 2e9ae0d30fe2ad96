"""Rare excursions: flights of the batch engine that are copied where they come near to one."""
