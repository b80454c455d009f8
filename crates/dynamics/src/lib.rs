//! Dynamics of the grasped body: implicit integration, virtual coupling and penalty contact.
