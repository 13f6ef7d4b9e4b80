"""Where the objects truly are, from tables and boxes that others made."""
