"""What a render is: roles, layers, frames, sequences; reading and writing them."""
