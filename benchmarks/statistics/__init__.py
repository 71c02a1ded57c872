"""Statistics: intervals, rankings, paired differences, fronts."""
