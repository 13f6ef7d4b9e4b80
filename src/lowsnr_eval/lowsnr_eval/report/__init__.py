"""Pages, figures, tables and overlays."""
