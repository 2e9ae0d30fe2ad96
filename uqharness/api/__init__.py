"""The public face in Python: what ``import uqharness as uq`` offers, thin over the packages that
the commands use.
"""
