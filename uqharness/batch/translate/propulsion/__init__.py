"""``<propulsion>``: engines, thrusters, tanks, and the mass that follows from what is in them."""
