//! Training of SEAL's networks.
