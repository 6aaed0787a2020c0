"""What the machine and its user give: private files, run folders, seals, standard streams, the interpreter."""
