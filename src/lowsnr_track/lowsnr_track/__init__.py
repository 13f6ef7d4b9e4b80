"""Data association and the multiple-model particle filter."""
