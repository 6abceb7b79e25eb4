"""VDM formulations: each module assembles its own operator behind one interface."""
