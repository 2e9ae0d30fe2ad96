"""One flight: its specification, steps, levels, turbulence, scores and record."""
