"""What stands and moves in a filmed scene, as pieces that a renderer can draw."""
