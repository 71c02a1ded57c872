"""Estimate and truth to scores: suites, runner, statistics, bounds, report."""
