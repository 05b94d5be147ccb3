"""How does it look? Figures and pages: draws what others computed."""
