"""What every service agrees on: messages, topics, identities, randomness, errors. No input or output here."""
