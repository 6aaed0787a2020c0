"""What the tools know: of a launch that runs, of its logs, of this machine, and how a project begins."""
