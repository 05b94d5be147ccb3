"""How fast, how exact, against what?"""
