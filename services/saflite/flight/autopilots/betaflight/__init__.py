"""Betaflight in lockstep with our world: its own simulator build as an external program, none of its code in here."""
