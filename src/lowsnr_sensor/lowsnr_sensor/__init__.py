"""Motion and sensor models, scenarios, the simulator and the shared kernel."""
