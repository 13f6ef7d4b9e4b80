"""Plans, starts, supervises and ends a run; bags, recorder, player."""
