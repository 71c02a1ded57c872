"""The laws that every estimator is held to, run by `beambench estimators check` and by the tests.

`suite.py` and `singular.py` hold the laws, `maker.py` what they run on, `<modality>.py` the captures of a modality,
`check.py` the entry by label, `trial.py` the same in a process of its own.
"""
