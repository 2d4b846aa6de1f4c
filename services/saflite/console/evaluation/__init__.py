"""The paper's first two questions asked of scorer models, outside any campaign."""
