"""The two errors that a user of the public face meets."""

from sysid.errors import LogError
from uqharness.errors import BadInputError

__all__ = ["BadInputError", "LogError"]
