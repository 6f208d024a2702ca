"""Errors in how a command was called. Imports nothing heavy: it is loaded before numpy."""

from __future__ import annotations


class UsageError(ValueError):
    """The command line asks for something that cannot be done; the message is a sentence."""
