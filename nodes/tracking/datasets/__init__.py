"""Scene folders and results files of the BOP benchmark, and the world that plays them."""
