"""Design of measurements: settings of a rig that make the bound of the estimates of a scene least for its light."""
