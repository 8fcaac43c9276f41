"""What the method runs on: worker processes, stores for long columns, whole outputs, Open3D."""
