"""How well is a scan located on a floor plan, and on the map that is made of it."""
