"""The project's fuzzer: mutated inputs of every format that a user can hand in, each with an
outcome that is judged.

``python -m tests.fuzz --seconds 60`` runs it; docs/fuzzing.md tells what is promised.
"""
