"""Simulation of a four-wheeled omnidirectional robot with slip, and its gap workflow."""
