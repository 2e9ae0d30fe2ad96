"""Flights in air that the estimator's gust model does not describe, and what `refine` makes of
them."""
