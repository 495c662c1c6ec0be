"""Images and volumes reconstructed from captures."""
