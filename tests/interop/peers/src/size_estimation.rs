//! What generated code implements for shared memory, which is not used here.

pub trait SizeEstimation {
    fn estimated_cdr_size(&self) -> usize;
}
