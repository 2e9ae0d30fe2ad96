"""Intermediate form of the batch engine: functions, programs, passes over them, and an
interpreter.
"""
