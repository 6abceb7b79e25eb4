"""From a study file to typed objects, with every problem at once."""
