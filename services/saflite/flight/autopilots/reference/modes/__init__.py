"""Flight modes, one file each, beside the ArduCopter source they follow."""
