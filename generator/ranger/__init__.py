"""The forward models of rangers with one detector: recorded pulses, and amplitude modulation."""
