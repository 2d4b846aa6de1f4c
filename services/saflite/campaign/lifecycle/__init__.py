"""From a proposed test case to a confirmed, minimised violation. Pure."""
