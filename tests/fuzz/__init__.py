"""The project's fuzzer: mutated inputs of every format that a user can hand in, each with an
outcome that is judged.

``python -m tests.fuzz --seconds 60`` runs it; README.md has what counts as a finding.
"""
