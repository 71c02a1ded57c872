"""Emulated rigs: instruments in a process of their own, whose frames the generator renders at what is programmed at the time."""
