"""The laws that every estimator is held to, run by `estimators check` and by the tests."""
