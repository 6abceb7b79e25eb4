"""How far off. In: results of models on one surface. Out: metrics, error bars, small-strain limits, cases."""
