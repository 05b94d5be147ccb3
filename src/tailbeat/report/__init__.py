"""Figures and pages: draws what others computed."""
