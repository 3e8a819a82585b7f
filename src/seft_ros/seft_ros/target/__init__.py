"""The motion that the whole structure is going to have, from what is measured of the specimen."""
