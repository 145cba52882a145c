"""The kit of every page, figure and terminal table; knows neither study nor result."""
