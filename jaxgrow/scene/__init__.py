"""What a user asks for: lesion, surroundings, parameters; read and validated."""
