//! Parts of a scene: ranges of its splats that are drawn, each with a share. What is in no part costs a frame nothing: it is
//! neither sorted nor projected. Two levels of detail of one thing, with shares that add up to 1, cross-fade.

use crate::projection::MAX_ALPHA;
use std::hash::{DefaultHasher, Hash, Hasher};

/// A range of a scene's splats that is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// The first.
    pub first: u32,
    /// How many.
    pub splats: u32,
    /// Above 0; 1: as the scene says. See [`shared_opacity`].
    pub share: f32,
}

/// What is drawn of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Parts {
    list: Vec<Part>,
    splats: u32,
    id: u64,
}

impl Parts {
    /// Parts that do not overlap, in any order. Those without splats or share are left out.
    pub fn new(parts: impl IntoIterator<Item = Part>) -> Self {
        let mut list: Vec<Part> = parts.into_iter().filter(|p| p.splats > 0 && p.share > 0.0).collect();
        list.sort_unstable_by_key(|p| p.first);
        // Neighbours of one share are one part.
        list.dedup_by(|next, part| {
            let joined = part.share == next.share && part.first + part.splats == next.first;
            if joined {
                part.splats += next.splats;
            }
            joined
        });
        let mut hasher = DefaultHasher::new();
        let end = |p: &Part| p.first + p.splats;
        for (i, part) in list.iter().enumerate() {
            // Where a run of splats begins and ends, whatever its shares.
            if i == 0 || end(&list[i - 1]) != part.first {
                part.first.hash(&mut hasher);
            }
            if list.get(i + 1).is_none_or(|next| next.first != end(part)) {
                end(part).hash(&mut hasher);
            }
        }
        let splats = list.iter().map(|p| p.splats).sum();
        // 0 is the whole scene.
        Self { splats, id: hasher.finish().max(1), list }
    }

    /// The parts, by their first splats.
    pub fn list(&self) -> &[Part] {
        &self.list
    }

    /// Splats of all parts.
    pub fn splats(&self) -> u32 {
        self.splats
    }

    /// The same for the same splats, whatever the shares: an order of splats serves as long as it is the same. Never 0.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// The splats, in the scene's order.
    pub fn indices(&self) -> impl Iterator<Item = u32> + '_ {
        self.list.iter().flat_map(|p| p.first..p.first + p.splats)
    }
}

/// The opacity of a splat that is drawn with a share: `1 − (1 − o)^share`. What two levels of one thing let through
/// together, one with a share `s` and the other with `1 − s`, is then what one of them lets through: its optical depth is
/// shared out.
pub fn shared_opacity(opacity: f32, share: f32) -> f32 {
    if share < 1.0 { 1.0 - (1.0 - opacity.min(MAX_ALPHA as f32)).powf(share) } else { opacity }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(first: u32, splats: u32, share: f32) -> Part {
        Part { first, splats, share }
    }

    #[test]
    fn parts_are_in_the_scenes_order_and_known_by_their_splats() {
        let parts = Parts::new([part(10, 3, 1.0), part(0, 2, 0.5), part(20, 0, 1.0), part(30, 4, 0.0)]);
        assert_eq!(parts.indices().collect::<Vec<_>>(), [0, 1, 10, 11, 12]);
        assert_eq!((parts.splats(), parts.list().len()), (5, 2));
        let faded = Parts::new([part(0, 2, 0.6), part(10, 3, 0.4)]);
        let others = Parts::new([part(0, 2, 0.6), part(10, 4, 0.4)]);
        assert!(parts.id() == faded.id() && parts != faded && parts.id() != others.id());
        let joined = Parts::new([part(0, 2, 1.0), part(2, 3, 1.0)]);
        assert_eq!(joined.list(), [part(0, 5, 1.0)]);
        assert_eq!(joined.id(), Parts::new([part(0, 2, 0.2), part(2, 3, 0.8)]).id());
        assert_eq!(Parts::new([]).splats(), 0);
    }

    #[test]
    fn two_shares_let_through_what_one_splat_does() {
        for opacity in [0.01f32, 0.3, 0.9, 0.99] {
            for share in [0.1f32, 0.5, 0.8] {
                let through =
                    (1.0 - shared_opacity(opacity, share)) * (1.0 - shared_opacity(opacity, 1.0 - share));
                assert!((through - (1.0 - opacity)).abs() < 1e-5, "{opacity} {share}");
                // Control: opacities that are multiplied let a wall's back shine through.
                let naive = (1.0 - opacity * share) * (1.0 - opacity * (1.0 - share));
                assert!(opacity < 0.5 || naive > through + 0.02);
            }
            assert_eq!(shared_opacity(opacity, 1.0), opacity);
        }
        assert!(shared_opacity(1.0, 0.01) < 0.1, "even what is fully opaque comes gradually");
    }
}
