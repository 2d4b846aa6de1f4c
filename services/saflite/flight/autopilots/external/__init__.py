"""What adapters of autopilots in processes of their own share: process, lockstep link, listing, inputs, flight."""
