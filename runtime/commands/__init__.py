"""The command line: one file per command, a command being a plain function that returns its exit code."""
