"""Calibrations as other programs write them, one module a format; `registry` chooses."""
