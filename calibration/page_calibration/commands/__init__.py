"""One module a command of page-calibrate."""
