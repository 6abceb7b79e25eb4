"""The programs behind documented figures: benchmark, calibration, the claims of the paper on trial."""
