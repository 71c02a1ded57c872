"""Drivers: cameras, delay generators and oscilloscopes behind one small protocol; each is imported when it is opened."""
