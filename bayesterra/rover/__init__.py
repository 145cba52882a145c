"""A four-wheeled rover on a slope or against a tow force, from its wheels' forces by statics."""
