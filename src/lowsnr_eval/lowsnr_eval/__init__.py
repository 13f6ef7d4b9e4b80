"""Scoring, experiments, reports and the evaluator."""
