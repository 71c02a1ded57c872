"""Estimators of laser lines: the column of the line in each row (stage `line`), and the points it lies on (`triangulation`)."""
