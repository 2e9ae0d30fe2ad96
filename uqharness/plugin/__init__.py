"""The JSBSim system of uncertainty intervals: written, put into any aircraft, checked."""
