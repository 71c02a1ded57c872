"""The parts of `beambench doctor`: packages, renderer, caches and disks of this machine, looked at without changing them."""
