"""Evidence beside the books: a content-addressed store of blobs (traces, artefacts, recordings) in a run folder."""
