"""How well a run was tracked: results files, scores, plots and pictures."""
