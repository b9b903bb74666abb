#version 460
// The distance of every splat as a key whose bits are in the order of the numbers. Twin: renderer/src/order/mod.rs.
#include "scene.glsl"
#include "sort.glsl"

layout(set = 2, binding = 0, std430) writeonly buffer Keys { uint keys[]; };
layout(set = 2, binding = 1, std430) writeonly buffer Values { uint values[]; };
layout(set = 2, binding = 2, std430) readonly buffer Alive { uint alive[]; };

const uint KEY_DEPTH = 1u;   // depth, not distance
const uint KEY_16 = 2u;      // 16 bits
const uint KEY_LISTED = 4u;  // only the splats of a list
const uint KEY_PARTS = 8u;   // only the splats of the parts

// A smaller float has smaller bits; NaN comes last.
uint float_key(float v) {
    if (isnan(v)) return 0xffffffffu;
    uint bits = floatBitsToUint(v);
    return bits ^ (uint(int(bits) >> 31) | 0x80000000u);
}

void main() {
    uint slot = gl_GlobalInvocationID.x;
    if (slot >= sort.count) return;
    uint i = (sort.key & KEY_LISTED) != 0u ? alive[sort.first + slot] : slot;
    if ((sort.key & KEY_PARTS) != 0u) i = part_splat(slot);
    // Rounded as the processor rounds, operation by operation.
    precise vec3 mean = splat_mean(i);
    if (MOTION) mean = moved_mean(mean, i, frame.filters.w);
    precise vec3 d = mean - frame.sort_center.xyz;
    d -= vec3(sort.rest[0], sort.rest[1], sort.rest[2]);
    vec3 along = (sort.key & KEY_DEPTH) != 0u ? frame.views[0].rotation[2].xyz : d;
    precise float value = d.x * along.x + d.y * along.y;
    value += d.z * along.z;
    if ((sort.key & (KEY_DEPTH | KEY_16)) == KEY_16) value = sqrt(value);
    uint key = float_key(value);
    keys[slot] = (sort.key & KEY_16) != 0u ? key >> 16 : key;
    if ((sort.key & (KEY_LISTED | KEY_PARTS)) != 0u) values[slot] = i;
}
