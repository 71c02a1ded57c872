"""The card of a data set: what it is, who may use it, how it was made, figures, sample pictures and the check of its split."""
