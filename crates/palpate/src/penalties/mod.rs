//! Penalty contacts, as in the dissertation (ch. 5): of a [proxy](proxy) that stays outside the surfaces, in
//! [groups](group) by scene object, clustered or [merged](merging) to few planes with springs, with
//! [textures](textures) on them.

pub(crate) mod group;
pub(crate) mod in_scene;
pub(crate) mod lookahead;
pub(crate) mod merging;
pub(crate) mod proxy;
pub(crate) mod textures;
