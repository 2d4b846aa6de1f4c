/* Look-ahead tree and the path in it (seed-systems 5.5, 5.6). */
#include "exact_math.h"
#include "planner_state.h"

#include <string.h>

static float distance(const float a[3], const float b[3])
{
    const float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return sqrtf(x * x + y * y + z * z);
}

static int crowded(const Planner *p, const float place[3])
{
    for (int i = 0; i < p->n_nodes; i++)
        if (distance(p->nodes[i].position, place) < 0.2f)
            return 1;
    return 0;
}

static void add_child(Planner *p, int parent, const Candidate *candidate, const float goal[3])
{
    const Node *from = &p->nodes[parent];
    const int cell = candidate->row * AZIMUTHS + candidate->column;
    const float reach = p->set.node_distance;
    const float leap[3] = {reach * p->dir_x[cell], reach * p->dir_y[cell], reach * p->dir_z[cell]};
    Node *node = &p->nodes[p->n_nodes];
    for (int i = 0; i < 3; i++) {
        node->position[i] = from->position[i] + leap[i];
        node->velocity[i] = leap[i];
    }
    if (p->n_nodes >= NODES_MAX || crowded(p, node->position))
        return;
    node->heuristic = p->set.heuristic * distance(node->position, goal);
    node->total = from->total - from->heuristic + candidate->cost + node->heuristic;
    node->parent = (short)parent;
    node->depth = (short)(from->depth + 1);
    node->closed = 0;
    p->n_nodes++;
}

static void expand(Planner *p, int parent, const View *root)
{
    Candidate best[CHILDREN_MAX];
    View view = *root;
    memcpy(view.eye, p->nodes[parent].position, sizeof view.eye);
    memcpy(view.velocity, p->nodes[parent].velocity, sizeof view.velocity);
    const int n = costs_candidates(p, &view, best, p->set.children);
    for (int i = 0; i < n && p->n_nodes < NODES_MAX; i++)
        add_child(p, parent, &best[i], root->goal);
    p->nodes[parent].closed = 1;
}

/* Cheapest open node within range of the vehicle; -1 if there is none. */
static int next_node(const Planner *p, const float eye[3])
{
    int chosen = -1;
    float least = 3e38f;
    for (int i = 0; i < p->n_nodes; i++)
        if (!p->nodes[i].closed && p->nodes[i].total < least && distance(p->nodes[i].position, eye) < p->set.range) {
            least = p->nodes[i].total;
            chosen = i;
        }
    return chosen;
}

static void take_path(Planner *p, double now_s)
{
    int end = 0, depth = 0;
    for (int i = 0; i < p->n_nodes; i++)
        if (!p->nodes[i].closed && p->nodes[i].depth > depth) {
            depth = p->nodes[i].depth;
            end = i;
        }
    p->n_path = depth + 1;
    for (int i = depth; i >= 0; i--) {
        memcpy(p->path[i], p->nodes[end].position, sizeof p->path[i]);
        end = p->nodes[end].parent;
    }
    p->path_made_s = now_s;
}

void tree_search(Planner *p, const View *root, double now_s)
{
    Node *first = &p->nodes[0];
    memset(first, 0, sizeof *first);
    memcpy(first->position, root->eye, sizeof first->position);
    memcpy(first->velocity, root->velocity, sizeof first->velocity);
    first->heuristic = first->total = p->set.heuristic * distance(root->eye, root->goal);
    p->n_nodes = 1;
    for (int n = 0, node = 0; n < p->set.expansions && node >= 0; n++) {
        expand(p, node, root);
        node = next_node(p, root->eye);
    }
    take_path(p, now_s);
}

/* The point a vehicle would have reached that flies along the path at the path speed since it was made, starting at
 * the first node; returns 0 once that is past the last node. A path of one leg gives its end and never ends. */
int path_point(const Planner *p, double now_s, float point[3])
{
    if (p->n_path < 2)
        return 0;
    memcpy(point, p->path[1], sizeof(float) * 3);
    if (p->n_path == 2)
        return 1;
    float left = (float)(now_s - p->path_made_s) * p->set.path_speed;
    for (int i = 1; i + 1 < p->n_path; i++) {
        const float leg = distance(p->path[i], p->path[i + 1]);
        for (int axis = 0; axis < 3; axis++)
            point[axis] = p->path[i][axis] + (left / leg) * (p->path[i + 1][axis] - p->path[i][axis]);
        if (left < leg)
            return 1;
        left -= leg;
    }
    return 0;
}
