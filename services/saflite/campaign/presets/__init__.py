"""Campaigns that ship, and those made from policy files."""
