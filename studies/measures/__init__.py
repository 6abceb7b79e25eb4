"""Accuracy. In: results of models on one surface. Out: metrics, error bars, cases."""
