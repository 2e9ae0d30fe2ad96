"""Checks of channels and records: units, signs, delays, damage, and signals that no sensor
measured.
"""
