"""The subcommands of page-runtime, a module each; cli.py imports the one that is asked for."""
