"""From names in deployment files and rosters to code: which may be loaded, and how it is built."""
