//! The widest vector instructions that the machine has, chosen at run time.
//!
//! The compiler turns loops over [`crate::detect::band::LANES`] numbers into vector instructions. It never contracts a product
//! and a sum, nor reorders sums: the same source gives the same bits with any width.

/// Something to be compiled for several widths: `run` must be `#[inline(always)]`, and what it calls inlined, to gain from it.
pub(crate) trait Work {
    /// What comes out.
    type Out;
    /// Does it.
    fn run(self) -> Self::Out;
}

/// Runs `work` compiled for the widest vectors available.
#[inline]
pub(crate) fn wide<W: Work>(work: W) -> W::Out {
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx512f")
            && std::arch::is_x86_feature_detected!("avx512dq")
            && std::arch::is_x86_feature_detected!("avx512vl")
        {
            // SAFETY: the features were found on this machine.
            #[allow(unsafe_code)]
            return unsafe { with_avx512(work) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the feature was found on this machine.
            #[allow(unsafe_code)]
            return unsafe { with_avx2(work) };
        }
    }
    work.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2<W: Work>(work: W) -> W::Out {
    work.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512vl")]
fn with_avx512<W: Work>(work: W) -> W::Out {
    work.run()
}
