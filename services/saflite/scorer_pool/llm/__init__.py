"""Scores from language models: prompt, answers, transcript, cache, circuit breaker."""
