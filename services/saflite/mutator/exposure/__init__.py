"""What the strategy `exposure` is made of: hints, vocabulary, state model, corpus, attention, phases."""
