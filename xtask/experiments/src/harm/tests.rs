use super::session::run;
use super::*;
