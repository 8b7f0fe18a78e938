"""What a sample, a start and a byte cost as scenes grow: `make scaling` writes out/scaling.csv and scaling.png."""
