"""The one node that runs any detector."""
