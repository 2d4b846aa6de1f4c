"""Proposes test cases: strategies that ask and tell, operators that change one thing."""
