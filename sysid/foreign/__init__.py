"""Readers of files that other people hand in: bounded in time and memory, without running code."""
