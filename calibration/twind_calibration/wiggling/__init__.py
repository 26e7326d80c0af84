"""A small move of one joint, and what it shows: by the encoder, by the load, by the eye. A client."""
